"""Runs in an environment with LeRobot.

`making.py FOLDER KIND...` makes small checkpoints of random weights and computes LeRobot's actions, `making.py FOLDER
--only-act SIZE` makes one for images of that size (px), and `making.py FOLDER --pusht` or `--aloha` one for that task.
"""

import os
import sys
from pathlib import Path

import numpy as np
import torch

from tests.policies.lerobot import language

SIZE, STATE, DIM = 32, 8, 7
LOW, SWEEPS = (0.0, 0.21, 0.42, 0.0, 0.93, 0.0, 0.5), (0.15, 0.02, 0.02, 0.02, 0.02, 0.02, 0.3)
"""Targets of ALOHA's right arm by which it is above the table (rad, and its gripper), and how much they vary."""


def make(kind, folder, size=SIZE):
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
        "pi05": {"chunk_size": 6, "n_action_steps": 3, "num_inference_steps": 2, "image_resolution": (56, 56)},
    }
    if kind == "smolvla":
        language.write_vision_language_model(folder.parent / "vlm")
    elif kind == "pi05":
        language.make_pi05_small()
        language.write_tokenizer(folder.parent / language.TOKENIZER)
        os.chdir(folder.parent)  # where it is found by the name that LeRobot gives it
    numbers = {
        "observation.images.third_person": {"mean": 0.4, "std": 0.3, "min": 0.0, "max": 1.0},
        "observation.state": {"mean": 0.1, "std": 0.5, "min": -1.0, "max": 1.0, "q01": -0.9, "q99": 0.9},
        "action": {"mean": 0.001, "std": 0.02, "min": -0.05, "max": 0.05, "q01": -0.04, "q99": 0.04},
    }
    write(kind, folder, sizes[kind], numbers, ((3, size, size), (STATE,), (DIM,)), seed=7)
    if kind == "pi05":
        language.name_tokenizer(folder, folder.parent / language.TOKENIZER)


def make_pusht(folder):
    """Make an ACT whose targets are all over the board."""
    sizes = {"chunk_size": 10, "n_action_steps": 5, "dim_model": 32, "n_heads": 2, "dim_feedforward": 32}
    sizes |= {"n_encoder_layers": 1, "n_vae_encoder_layers": 1, "latent_dim": 4, "pretrained_backbone_weights": None}
    numbers = {
        "observation.image": {"mean": 0.5, "std": 0.3},
        "observation.state": {"mean": 256.0, "std": 100.0},
        "action": {"mean": 256.0, "std": 110.0},
    }
    write("act", folder, sizes, numbers, ((3, 96, 96), (2,), (2,)), seed=6)


def make_aloha(folder):
    """Make an ACT that moves the right arm about where the cube starts."""
    sizes = {"chunk_size": 20, "n_action_steps": 10, "dim_model": 32, "n_heads": 2, "dim_feedforward": 32}
    sizes |= {"n_encoder_layers": 1, "n_vae_encoder_layers": 1, "latent_dim": 4, "pretrained_backbone_weights": None}
    left = [0.0, -0.96, 1.16, 0.0, -0.3, 0.0, 0.5]
    numbers = {
        "observation.images.top": {"mean": 0.5, "std": 0.3},
        "observation.state": {"mean": 0.0, "std": 1.0},
        "action": {"mean": [*left, *LOW], "std": [*[0.1] * 7, *SWEEPS]},
    }
    write("act", folder, sizes, numbers, ((3, 480, 640), (14,), (14,)), seed=6)


def write(kind, folder, sizes, numbers, shapes, seed):
    """Write a checkpoint of random weights with these statistics; names and shapes are of image, state and action."""
    from lerobot.configs.types import FeatureType, PolicyFeature
    from lerobot.policies.factory import get_policy_class, make_policy_config, make_pre_post_processors

    kinds = (FeatureType.VISUAL, FeatureType.STATE, FeatureType.ACTION)
    image, state, action = map(PolicyFeature, kinds, shapes)
    seen, done = zip(numbers, (image, state), strict=False), {"action": action}
    config = make_policy_config(kind, input_features=dict(seen), output_features=done, device="cpu", **sizes)
    torch.manual_seed(seed)
    policy = get_policy_class(kind)(config)
    statistics = {
        name: {
            key: torch.tensor(value).broadcast_to((3, 1, 1) if len(shape) > 1 else shape).clone()
            for key, value in values.items()
        }
        for (name, values), shape in zip(numbers.items(), shapes, strict=True)
    }
    for part in (policy, *make_pre_post_processors(config, dataset_stats=statistics)):
        part.save_pretrained(folder)


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
    for option, making in {"--pusht": make_pusht, "--aloha": make_aloha}.items():
        if option in sys.argv:
            making(Path(sys.argv[1]))
            sys.exit()
    if "--only-act" in sys.argv:
        make("act", Path(sys.argv[1]), int(sys.argv[3]))
        sys.exit()
    for one in sys.argv[2:]:
        make(one, Path(sys.argv[1]) / one)
        answer(Path(sys.argv[1]), one)
