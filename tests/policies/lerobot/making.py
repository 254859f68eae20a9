"""Runs in an environment with LeRobot.

`making.py FOLDER KIND...` makes small checkpoints of random weights and computes LeRobot's actions, `making.py FOLDER
--only-act SIZE` makes one for images of that size (px).
"""

import os
import sys
from pathlib import Path

import numpy as np
import torch

from tests.policies.lerobot import language

SIZE, STATE, DIM = 32, 8, 7


def make(kind, folder, size=SIZE):
    from lerobot.configs.types import FeatureType, PolicyFeature
    from lerobot.policies.factory import get_policy_class, make_policy_config, make_pre_post_processors

    image, state = "observation.images.third_person", "observation.state"
    seen = {
        image: PolicyFeature(FeatureType.VISUAL, (3, size, size)),
        state: PolicyFeature(FeatureType.STATE, (STATE,)),
    }
    sizes = {
        "act": {
            "chunk_size": 6,
            "n_action_steps": 3,
            "dim_model": 16,
            "n_heads": 2,
            "dim_feedforward": 16,
            "n_encoder_layers": 1,
            "n_vae_encoder_layers": 1,
            "latent_dim": 4,
            "pretrained_backbone_weights": None,
        },
        "diffusion": {
            "horizon": 8,
            "n_action_steps": 3,
            "n_obs_steps": 2,
            "down_dims": (8, 16),
            "n_groups": 4,
            "diffusion_step_embed_dim": 8,
            "num_train_timesteps": 3,
            "crop_shape": None,
            "spatial_softmax_num_keypoints": 4,
            "pretrained_backbone_weights": None,
            "use_group_norm": True,
        },
        "smolvla": {
            "chunk_size": 6,
            "n_action_steps": 3,
            "vlm_model_name": str(folder.parent / "vlm"),
            "num_vlm_layers": 2,
            "num_steps": 2,
            "resize_imgs_with_padding": (64, 64),
        },
        "pi05": {
            "chunk_size": 6,
            "n_action_steps": 3,
            "num_inference_steps": 2,
            "image_resolution": (56, 56),
        },
    }
    done = {"action": PolicyFeature(FeatureType.ACTION, (DIM,))}
    config = make_policy_config(kind, input_features=seen, output_features=done, device="cpu", **sizes[kind])
    if kind == "smolvla":
        language.write_vision_language_model(folder.parent / "vlm")
    elif kind == "pi05":
        language.make_pi05_small()
        language.write_tokenizer(folder.parent / language.TOKENIZER)
        os.chdir(folder.parent)  # where it is found by the name that LeRobot gives it
    torch.manual_seed(7)
    policy = get_policy_class(kind)(config)
    statistics = {
        name: {key: torch.full(shape, value) for key, value in values.items()}
        for name, shape, values in (
            (image, (3, 1, 1), {"mean": 0.4, "std": 0.3, "min": 0.0, "max": 1.0}),
            (state, (STATE,), {"mean": 0.1, "std": 0.5, "min": -1.0, "max": 1.0, "q01": -0.9, "q99": 0.9}),
            ("action", (DIM,), {"mean": 0.001, "std": 0.02, "min": -0.05, "max": 0.05, "q01": -0.04, "q99": 0.04}),
        )
    }
    for part in (policy, *make_pre_post_processors(config, dataset_stats=statistics)):
        part.save_pretrained(folder)
    if kind == "pi05":
        language.name_tokenizer(folder, folder.parent / language.TOKENIZER)


def answer(folder, kind):
    """Return the actions of LeRobot's `predict_action` at each step, seeded where an observation is used."""
    from lerobot.configs.policies import PreTrainedConfig
    from lerobot.policies.factory import get_policy_class, make_pre_post_processors

    try:
        from lerobot.common.control_utils import predict_action
    except ModuleNotFoundError:  # LeRobot 0.4
        from lerobot.utils.control_utils import predict_action

    torch.set_num_threads(1)
    config = PreTrainedConfig.from_pretrained(folder / kind)
    policy = get_policy_class(config.type).from_pretrained(folder / kind)
    before, after = make_pre_post_processors(config, pretrained_path=str(folder / kind))
    asked = np.load(folder / "asked.npz")
    policy.reset()
    rows = []
    for image, state, seed in zip(asked["images"], asked["states"], asked[kind], strict=True):
        if seed >= 0:
            torch.manual_seed(int(seed))
        seen = {"observation.images.third_person": image, "observation.state": state}
        rows.append(predict_action(seen, policy, torch.device("cpu"), before, after, False, task="reach"))
    np.save(folder / f"{kind}.npy", np.concatenate([row.numpy() for row in rows]))


if __name__ == "__main__":
    from robogauntlet.policies.lerobot.child import torchvision_beside_any_torch

    torchvision_beside_any_torch(torch)
    if "--only-act" in sys.argv:
        make("act", Path(sys.argv[1]), int(sys.argv[3]))
        sys.exit()
    for one in sys.argv[2:]:
        make(one, Path(sys.argv[1]) / one)
        answer(Path(sys.argv[1]), one)
