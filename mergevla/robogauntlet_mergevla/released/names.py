"""Names and layouts of the weights in released checkpoints of MergeVLA, VLA-Adapter and Prismatic. Light: no torch.

A released name is written as the fine-tuning code saves it: `vision_backbone`, `projector`, `language_model` and
`action_queries` as in `model.safetensors`, `action_head` and `proprio_projector` before the names in those two files.
Prismatic's own names are changed to these, as that code does when it starts from Prismatic.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType


class Kind(StrEnum):
    """What was released."""

    MERGEVLA = "mergevla"
    """An expert (arXiv 2511.18810)."""
    VLA_ADAPTER = "vla-adapter"
    """A policy of VLA-Adapter-Pro (arXiv 2509.09372)."""
    PRISMATIC = "prismatic"
    """A vision-language model (arXiv 2402.07865) without an action expert."""


class Layout(StrEnum):
    """How a released tensor differs from ours."""

    SAME = "same"
    QUERY, KEY, VALUE = "query", "key", "value"
    """Ours is a third of its rows."""
    PATCHES = "patches"
    """Positions (1, n, width) of the patches alone; ours begin with one for the class token, which timm includes in
    the token itself."""
    BATCHED = "batched"
    """Ours has no leading axis of size 1."""
    NONE = "none"
    """There is no such tensor: ours is not used, and zero."""


@dataclass(frozen=True)
class Source:
    """The released tensor that one of ours comes from."""

    name: str
    layout: Layout = Layout.SAME


DINOV2, SIGLIP = "vision_backbone.featurizer.", "vision_backbone.fused_featurizer."
ACTION_HEAD, PROPRIOCEPTION = "action_head.", "proprio_projector."
FINAL = (ACTION_HEAD + "model.fc2.weight", ACTION_HEAD + "model.fc2.bias")
DINOV2_POSITIONS = DINOV2 + "pos_embed"

_VISION = (
    (r"dinov2\.embeddings\.cls_token", DINOV2 + "cls_token"),
    (r"dinov2\.embeddings\.register_tokens", DINOV2 + "reg_token"),
    (r"dinov2\.embeddings\.patch_embeddings\.projection\.", DINOV2 + "patch_embed.proj."),
    (r"dinov2\.encoder\.layer\.(\d+)\.attention\.o_proj\.", DINOV2 + r"blocks.\1.attn.proj."),
    (r"dinov2\.encoder\.layer\.(\d+)\.layer_scale(\d)\.lambda1", DINOV2 + r"blocks.\1.ls\2.scale_factor"),
    (r"dinov2\.encoder\.layer\.(\d+)\.", DINOV2 + r"blocks.\1."),
    (r"dinov2\.layernorm\.", DINOV2 + "norm."),
    (r"siglip\.embeddings\.patch_embedding\.", SIGLIP + "patch_embed.proj."),
    (r"siglip\.encoder\.layers\.(\d+)\.layer_norm(\d)\.", SIGLIP + r"blocks.\1.norm\2."),
    (r"siglip\.encoder\.layers\.(\d+)\.self_attn\.out_proj\.", SIGLIP + r"blocks.\1.attn.proj."),
    (r"siglip\.encoder\.layers\.(\d+)\.", SIGLIP + r"blocks.\1."),
    (r"siglip\.post_layernorm\.", SIGLIP + "norm."),
)
_BLOCK = {
    "q_task": "q_proj_task",
    "output": "o_proj",
    "gate": "gating_factor",
    "norm": "ffn.0",
    "feed_forward": "ffn.1",
}
_BLOCKS = ACTION_HEAD + r"model.mlp_resnet_blocks.\1."
_COMMON = (
    *((rf"backbone\.vision\.{ours}", theirs) for ours, theirs in _VISION),
    (r"backbone\.projector\.0\.", "projector.fc1."),
    (r"backbone\.projector\.2\.", "projector.fc2."),
    (r"backbone\.projector\.4\.", "projector.fc3."),
    (r"backbone\.language\.", "language_model.model."),
    (r"action_queries$", "action_queries.weight"),
    (r"proprioception\.0\.", PROPRIOCEPTION + "fc1."),
    (r"proprioception\.2\.", PROPRIOCEPTION + "fc2."),
    (r"action_expert\.input_norm\.", ACTION_HEAD + "model.layer_norm1."),
    (r"action_expert\.input\.", ACTION_HEAD + "model.fc1."),
    (r"action_expert\.output_norm\.", ACTION_HEAD + "model.layer_norm2."),
    (r"action_expert\.output\.", ACTION_HEAD + "model.fc2."),
    *((rf"action_expert\.blocks\.(\d+)\.{ours}", _BLOCKS + theirs) for ours, theirs in _BLOCK.items()),
    (r"action_expert\.blocks\.(\d+)\.(?=[kv]_)", _BLOCKS),
)
_QUERY = r"action_expert\.blocks\.(\d+)\.q_adapter"
RULES: Mapping[Kind, tuple[tuple[str, str], ...]] = MappingProxyType(
    {
        Kind.MERGEVLA: (*_COMMON, (_QUERY, _BLOCKS + "q_proj_adapter")),
        Kind.VLA_ADAPTER: (*_COMMON, (_QUERY, _BLOCKS + "q_proj")),
        Kind.PRISMATIC: _COMMON,
    }
)
"""Ours to theirs: how a name begins, and with what instead. The first that fits is used."""

_ATTENTION = re.compile(
    r"backbone\.vision\.(dinov2|siglip)\.encoder\.layers?\.(\d+)\.(?:attention|self_attn)\.([qkv])_proj\.(\w+)"
)
_THIRDS = {"q": Layout.QUERY, "k": Layout.KEY, "v": Layout.VALUE}
_TOWERS = {"dinov2": DINOV2, "siglip": SIGLIP}
_SPECIAL = {
    "backbone.vision.dinov2.embeddings.mask_token": Source("", Layout.NONE),
    "backbone.vision.dinov2.embeddings.position_embeddings": Source(DINOV2_POSITIONS, Layout.PATCHES),
    "backbone.vision.siglip.embeddings.position_embedding.weight": Source(SIGLIP + "pos_embed", Layout.BATCHED),
}

_CHANGES = (
    ("module.", ""),
    ("base_model.model.", ""),
    ("vision_backbone.dino_featurizer.", DINOV2),
    ("vision_backbone.siglip_featurizer.", SIGLIP),
    ("llm_backbone.llm.", "language_model."),
    ("projector.projector.0.", "projector.fc1."),
    ("projector.projector.2.", "projector.fc2."),
    ("projector.projector.4.", "projector.fc3."),
)
"""Beginnings of names in the order in which they are changed."""
UNUSED = re.compile(r"language_model\.lm_head\.|.*\.attn_pool\.|.*\.film_gen\.|.*\binv_freq$")
"""Released tensors that the policies do not use: the tied output embeddings, SigLIP's pooling, VLA-Adapter's FiLM."""


def source_of(ours: str, kind: Kind) -> Source:
    """Return where one of our tensors is in a checkpoint of this kind."""
    if ours in _SPECIAL:
        return _SPECIAL[ours]
    if match := _ATTENTION.fullmatch(ours):
        tower, block, third, part = match.groups()
        return Source(f"{_TOWERS[tower]}blocks.{block}.attn.qkv.{part}", _THIRDS[third])
    for beginning, instead in RULES[kind]:
        if match := re.match(beginning, ours):
            return Source(match.expand(instead) + ours[match.end() :])
    raise KeyError(ours)


def released_names(names: Iterable[str]) -> dict[str, str]:
    """Return the names in one file, each with the name by which `source_of` knows it.

    Which part of a checkpoint a file holds is recognised by its names, since all its names lack the part's own.
    """
    renamed = {name: _renamed(name) for name in names}
    found = set(renamed.values())
    prefix = ""
    if any(name.startswith("model.mlp_resnet_blocks.") for name in found):
        prefix = ACTION_HEAD
    elif found and all(re.fullmatch(r"fc[12]\.(weight|bias)", name) for name in found):
        prefix = PROPRIOCEPTION
    elif "reg_token" in found:
        prefix = DINOV2
    elif "patch_embed.proj.weight" in found:
        prefix = SIGLIP
    return {name: prefix + new for name, new in renamed.items()}


def _renamed(name: str) -> str:
    for old, new in _CHANGES:
        if name.startswith(old):
            name = new + name.removeprefix(old)
    return re.sub(r"\.(ls\d)\.gamma$", r".\1.scale_factor", name)
