"""The vision-language model: vision features, a projector, and a decoder.

`transformers` is imported only where pretrained towers or weights need it: it takes seconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor, nn

from robogauntlet.policies.contract import PolicyError
from robogauntlet.support.errors import first_line
from robogauntlet_mergevla.network.config import Architecture, ConvStem, Tower, Towers
from robogauntlet_mergevla.network.decoder import Decoder
from robogauntlet_mergevla.network.tokenizer import Prompts

REGISTERS = 4
IMAGENET_MEAN, IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


@dataclass(frozen=True)
class HiddenStates:
    """Input of the action expert and of routers: one tensor per layer, first the embeddings, last after the norm."""

    task: tuple[Tensor, ...]
    """h_T, at the positions of the patches, each of shape (B, patches, width)."""
    action: tuple[Tensor, ...]
    """h_A, at the positions of the action queries, each of shape (B, queries, width)."""


@dataclass(frozen=True)
class Pretrained:
    """Sources of pretrained weights, each a local folder or a hub id. Only safetensors are read."""

    language: str = "Qwen/Qwen2.5-0.5B"
    dinov2: str = "facebook/dinov2-with-registers-large"
    siglip: str = "google/siglip-so400m-patch14-224"


class ConvStems(nn.Module):
    """One stack of convolutions per camera, with learned positions."""

    def __init__(self, config: ConvStem, cameras: int, image_size: int) -> None:
        super().__init__()
        self.stems = nn.ModuleList(_stem(config) for _ in range(cameras))
        self.positions = nn.Parameter(torch.randn(cameras, config.patches(image_size), config.width) * 0.02)

    def forward(self, images: Tensor) -> Tensor:
        """Images (B, cameras, 3, H, W) in [0, 1] to features (B, patches of all cameras, width)."""
        maps = [stem(images[:, camera] * 2.0 - 1.0) for camera, stem in enumerate(self.stems)]
        return torch.cat(
            [m.flatten(2).transpose(1, 2) + position for m, position in zip(maps, self.positions, strict=True)], dim=1
        )


class DualTowers(nn.Module):
    """DINOv2 and SigLIP side by side."""

    def __init__(self, config: Towers) -> None:
        from transformers import Dinov2WithRegistersModel, SiglipVisionModel

        super().__init__()
        self.dinov2 = Dinov2WithRegistersModel(_dinov2_config(config.dinov2))
        self.siglip = SiglipVisionModel(_siglip_config(config.siglip, exact_gelu=config.exact_gelu))

    def forward(self, images: Tensor) -> Tensor:
        """Images (B, cameras, 3, H, W) in [0, 1] to features (B, patches of all cameras, 1024 + 1152)."""
        pixels = images.flatten(0, 1)
        mean, std = (pixels.new_tensor(values).view(3, 1, 1) for values in (IMAGENET_MEAN, IMAGENET_STD))
        dinov2 = self.dinov2((pixels - mean) / std, output_hidden_states=True).hidden_states[-2][:, 1 + REGISTERS :]
        siglip = self.siglip(pixels * 2.0 - 1.0, output_hidden_states=True).hidden_states[-2]
        return torch.cat([dinov2, siglip], dim=-1).unflatten(0, images.shape[:2]).flatten(1, 2)


class Backbone(nn.Module):
    """Decodes images, prompt and action queries as one sequence into the hidden states of every layer."""

    def __init__(self, architecture: Architecture) -> None:
        super().__init__()
        self.architecture = architecture
        vision = architecture.vision
        self.vision: nn.Module = (
            ConvStems(vision, len(architecture.cameras), architecture.image_size)
            if isinstance(vision, ConvStem)
            else DualTowers(vision)
        )
        layers: list[nn.Module] = []
        for before, after in pairwise((vision.width, *architecture.projector, architecture.width)):
            layers += [nn.Linear(before, after), nn.GELU()]
        self.projector = nn.Sequential(*layers[:-1])
        self.language = Decoder(architecture.language)

    def forward(self, images: Tensor, prompts: Prompts, queries: Tensor) -> HiddenStates:
        """Compute the hidden states.

        Args:
            images: Shape (B, cameras, 3, H, W), in [0, 1]; PolicyError for another shape than the architecture's.
            prompts: The instructions, batch B.
            queries: The action queries, shape (queries, width).
        """
        architecture, quirks = self.architecture, self.architecture.quirks
        size = architecture.image_size
        expected = (len(architecture.cameras), 3, size, size)
        if tuple(images.shape[1:]) != expected:
            raise PolicyError(f"expected images of shape (B, {', '.join(map(str, expected))}), got {(*images.shape,)}")
        patches = self.projector(self.vision(images))
        words = self.language.embed_tokens(prompts.ids)
        batch, count = patches.shape[:2]
        all_patches = prompts.present.new_ones(batch, count)
        all_queries = prompts.present.new_ones(batch, len(queries))
        # The paper's order is prompt start, patches, prompt; the repaired one has the whole prompt before the patches.
        ahead = 1 if quirks.language_blind else words.shape[1]
        sequence = torch.cat([words[:, :ahead], patches, words[:, ahead:], queries.expand(batch, -1, -1)], dim=1)
        present = torch.cat([prompts.present[:, :ahead], all_patches, prompts.present[:, ahead:], all_queries], dim=1)
        layers = self._decode(sequence, present)
        shift = 1 if quirks.shifted_slices else 0
        first, last = ahead - shift, sequence.shape[1] - shift
        return HiddenStates(
            task=tuple(layer[:, first : first + count] for layer in layers),
            action=tuple(layer[:, last - len(queries) : last] for layer in layers),
        )

    def _decode(self, sequence: Tensor, present: Tensor) -> list[Tensor]:
        """Return the hidden states of all layers. Positions count present tokens only, so padding has no effect."""
        length = sequence.shape[1]
        positions = (present.long().cumsum(1) - 1).clamp(min=0)
        allowed = present[:, None, None, :]
        if not self.architecture.language.bidirectional or self.architecture.quirks.language_blind:
            allowed = allowed & torch.ones(length, length, dtype=torch.bool, device=sequence.device).tril()
        return self.language(sequence, positions, allowed)


def load_pretrained(backbone: Backbone, source: Pretrained) -> None:
    """Fill the decoder, and the towers if there are any, with pretrained weights; not the projector.

    Raises PolicyError for weights that cannot be read as safetensors, or are of another architecture.
    """
    from transformers import Dinov2WithRegistersModel, Qwen2Model, SiglipVisionModel

    _fill(backbone.language, Qwen2Model, source.language)
    if isinstance(backbone.vision, DualTowers):
        _fill(backbone.vision.dinov2, Dinov2WithRegistersModel, source.dinov2)
        _fill(backbone.vision.siglip, SiglipVisionModel, source.siglip)


def _fill(module: nn.Module, kind: Any, source: str) -> None:
    try:
        weights = kind.from_pretrained(source, use_safetensors=True).state_dict()
    except (OSError, ValueError, RuntimeError) as error:
        raise PolicyError(f"expected pretrained safetensors at '{source}', got: {first_line(error)}") from None
    state = module.state_dict()
    for name, tensor in state.items():
        if name not in weights or weights[name].shape != tensor.shape:
            shape = tuple(weights[name].shape) if name in weights else "nothing"
            raise PolicyError(f"{source}: expected {name} of shape {tuple(tensor.shape)}, got {shape}")
    module.load_state_dict({name: weights[name] for name in state})


def _stem(config: ConvStem) -> nn.Sequential:
    layers: list[nn.Module] = []
    for before, after in pairwise((3, *config.channels)):
        layers += [nn.Conv2d(before, after, 3, stride=2, padding=1), nn.GroupNorm(config.groups, after), nn.GELU()]
    return nn.Sequential(*layers)


def _dinov2_config(config: Tower) -> Any:
    from transformers import Dinov2WithRegistersConfig

    return Dinov2WithRegistersConfig(
        hidden_size=config.width,
        num_hidden_layers=config.layers,
        num_attention_heads=config.heads,
        mlp_ratio=config.feed_forward // config.width,
        image_size=config.image_size,
        patch_size=config.patch_size,
        num_register_tokens=REGISTERS,
    )


def _siglip_config(config: Tower, *, exact_gelu: bool) -> Any:
    from transformers import SiglipVisionConfig

    return SiglipVisionConfig(
        hidden_act="gelu" if exact_gelu else "gelu_pytorch_tanh",
        hidden_size=config.width,
        num_hidden_layers=config.layers,
        num_attention_heads=config.heads,
        intermediate_size=config.feed_forward,
        image_size=config.image_size,
        patch_size=config.patch_size,
        vision_use_head=False,
    )
