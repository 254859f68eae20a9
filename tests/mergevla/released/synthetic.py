"""Released checkpoints with random numbers: the released names and shapes, written down apart from the importer."""

import json

import torch
from safetensors.torch import save_file

from tests.mergevla.network.test_pretrained import LITTLE

STATISTICS = {
    "libero_spatial_no_noops": {
        "action": {"q01": [-0.5] * 6 + [0.0], "q99": [0.5] * 6 + [1.0], "mask": [True] * 6 + [False]},
        "proprio": {"q01": [-1.0] * 8, "q99": [1.0] * 8},
        "num_transitions": 52970,
    }
}


def linear(name, rows, columns):
    return {f"{name}.weight": (rows, columns), f"{name}.bias": (rows,)}


def norm(name, width):
    return {f"{name}.weight": (width,), f"{name}.bias": (width,)}


def tower(name, size, image_size, *, dinov2):
    """timm's vision transformer: DINOv2 with a class token, registers and layer scales, SigLIP with a pooling head."""
    d, patch = size.width, size.patch_size
    shapes = {f"{name}.pos_embed": (1, (image_size // patch) ** 2, d)}
    shapes |= {f"{name}.patch_embed.proj.weight": (d, 3, patch, patch), f"{name}.patch_embed.proj.bias": (d,)}
    if dinov2:
        shapes |= {f"{name}.cls_token": (1, 1, d), f"{name}.reg_token": (1, 4, d)}
    for i in range(size.layers):
        block = f"{name}.blocks.{i}"
        shapes |= norm(f"{block}.norm1", d) | norm(f"{block}.norm2", d)
        shapes |= linear(f"{block}.attn.qkv", 3 * d, d) | linear(f"{block}.attn.proj", d, d)
        shapes |= linear(f"{block}.mlp.fc1", size.feed_forward, d) | linear(f"{block}.mlp.fc2", d, size.feed_forward)
        if dinov2:
            shapes |= {f"{block}.ls{one}.scale_factor": (d,) for one in (1, 2)}
    shapes |= norm(f"{name}.norm", d)
    if not dinov2:
        shapes |= {f"{name}.attn_pool.latent": (1, 1, d)} | linear(f"{name}.attn_pool.kv", 2 * d, d)
    return shapes


def backbone(a):
    """`model.safetensors` without the action queries, with the output embeddings of a file that was not tied."""
    d, llm, first, second = a.width, a.language, *a.projector
    heads = d // llm.heads * llm.key_value_heads
    shapes = tower("vision_backbone.featurizer", a.vision.dinov2, a.image_size, dinov2=True)
    shapes |= tower("vision_backbone.fused_featurizer", a.vision.siglip, a.image_size, dinov2=False)
    shapes |= linear("projector.fc1", first, a.vision.width) | linear("projector.fc2", second, first)
    shapes |= linear("projector.fc3", d, second)
    shapes |= {f"language_model.{n}.weight": (llm.vocabulary, d) for n in ("model.embed_tokens", "lm_head")}
    for i in range(llm.layers):
        layer = f"language_model.model.layers.{i}"
        for one, rows in (("q", d), ("k", heads), ("v", heads)):
            shapes |= linear(f"{layer}.self_attn.{one}_proj", rows, d)
        shapes |= {f"{layer}.self_attn.o_proj.weight": (d, d), f"{layer}.mlp.down_proj.weight": (d, llm.feed_forward)}
        shapes |= {f"{layer}.mlp.{one}_proj.weight": (llm.feed_forward, d) for one in ("gate", "up")}
        shapes |= {f"{layer}.{one}_layernorm.weight": (d,) for one in ("input", "post_attention")}
    return shapes | {"language_model.model.norm.weight": (d,)}


def action_head(a, *, pro):
    """The file `action_head--*.pt` of MergeVLA, or of VLA-Adapter-Pro, with its unused FiLM."""
    d, out = a.width, a.action_dim
    shapes = norm("module.model.layer_norm1", out * d) | linear("module.model.fc1", d, out * d)
    mergevla = ("q_proj_adapter", "k_adapter", "v_adapter", "q_proj_task", "k_task", "v_task", "o_proj")
    adapter = ("q_proj", "k_self", "v_self", "k_adapter", "v_adapter", "k_task", "v_task", "o_proj")
    for i in range(a.language.layers):
        block = f"module.model.mlp_resnet_blocks.{i}"
        for one in adapter if pro else mergevla:
            shapes |= linear(f"{block}.{one}", d, d)
        shapes |= norm(f"{block}.ffn.0", d) | linear(f"{block}.ffn.1", d, d) | {f"{block}.gating_factor": (1,)}
        if pro:
            shapes |= linear(f"{block}.film_gen.0", 2 * d, d)
    return shapes | norm("module.model.layer_norm2", d) | linear("module.model.fc2", out, d)


def projector(a):
    """The file `proprio_projector--*.pt`."""
    return linear("module.fc1", a.width, a.proprioception_dim) | linear("module.fc2", a.width, a.width)


def numbers(shapes, seed=0, dtype=torch.float32):
    """Random tensors of these shapes, the scales of norms about 1."""
    generator = torch.Generator().manual_seed(seed)
    centre = {name: 1.0 if "norm" in name and name.endswith("weight") else 0.0 for name in shapes}
    return {
        name: (centre[name] + 0.3 * torch.randn(shape, generator=generator)).to(dtype) for name, shape in shapes.items()
    }


def parts(kind, a=LITTLE, dtype=torch.float32):
    """File to tensors of a policy's checkpoint, or of a Prismatic one in its own names."""
    if kind == "prismatic":
        return {"latest-checkpoint.pt": numbers(prismatic(a), dtype=dtype)}
    return {
        "model.safetensors": numbers(backbone(a) | {"action_queries.weight": (a.action_queries, a.width)}, 1, dtype),
        "action_head--50000_checkpoint.pt": numbers(action_head(a, pro=kind == "vla-adapter"), 2, dtype),
        "proprio_projector--50000_checkpoint.pt": numbers(projector(a), 3, dtype),
    }


def prismatic(a=LITTLE):
    """Names in Prismatic's own checkpoint, whose parts are dictionaries of their own."""
    changes = (
        ("vision_backbone.featurizer", "vision_backbone.dino_featurizer"),
        ("vision_backbone.fused_featurizer", "vision_backbone.siglip_featurizer"),
        ("language_model", "llm_backbone.llm"),
        ("projector.fc1", "projector.projector.0"),
        ("projector.fc2", "projector.projector.2"),
        ("projector.fc3", "projector.projector.4"),
        ("scale_factor", "gamma"),
    )
    shapes = {}
    for name, shape in backbone(a).items():
        for old, new in changes:
            name = name.replace(old, new)
        shapes[name] = shape
    return shapes


def save(folder, kind, files=None, statistics=STATISTICS):
    """Write a checkpoint's files."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, tensors in (files or parts(kind)).items():
        if name.endswith(".safetensors"):
            save_file(tensors, folder / name)
        elif kind == "prismatic":
            torch.save({"model": _nested(tensors), "optimizer": {"step": torch.tensor(3)}}, folder / name)
        else:
            torch.save(tensors, folder / name)
    if statistics is not None and kind != "prismatic":
        (folder / "dataset_statistics.json").write_text(json.dumps(statistics))
    return folder


def _nested(tensors):
    nested = {}
    for name, tensor in tensors.items():
        part, _, rest = name.partition(".")
        nested.setdefault(part, {})[rest] = tensor
    return nested
