"""Low-rank adapters on the backbone (arXiv 2106.09685), trained through `peft`, and their deltas to the weights."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from robogauntlet.policies.contract import PolicyError
from robogauntlet_mergevla.network.config import LoraSettings
from robogauntlet_mergevla.network.model import MergeVLA

ADAPTER = "default"
BACKBONE = "backbone."


class LoraError(PolicyError):
    """Adapters that cannot be added or read."""


@dataclass(frozen=True)
class Factors:
    """One weight's adapter: it adds scale * B A."""

    a: Tensor
    """Shape (rank, ...)."""
    b: Tensor
    """Shape (out, rank, ...)."""
    scale: float
    shape: torch.Size
    """Shape of the weight."""

    def delta(self) -> Tensor:
        """Return scale * B A in fp32: differences of rounded weights would lose small entries."""
        a, b = self.a.detach().float().flatten(1), self.b.detach().float().flatten(1)
        return (self.scale * (b @ a)).reshape(self.shape)


def add_lora(model: MergeVLA, settings: LoraSettings, seed: int) -> None:
    """Freeze the backbone and add adapters to its layers; all other weights stay trainable.

    A is drawn from a Gaussian that depends on `seed` alone, B is zero: the network computes the same as before. Raises
    LoraError if there are adapters already, or the rank exceeds the network's width.
    """
    if has_lora(model):
        raise LoraError("expected a model without LoRA, got one that has it: fold it first")
    targets = [*_adapted(model, settings)]
    from peft import LoraConfig, inject_adapter_in_model  # several seconds of processor time, which acting saves

    config = LoraConfig(
        r=settings.rank,
        lora_alpha=settings.alpha,
        lora_dropout=0.0,
        init_lora_weights="gaussian",
        target_modules=targets,
    )
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        inject_adapter_in_model(config, model.backbone, adapter_name=ADAPTER)


def has_lora(model: MergeVLA) -> bool:
    """Return whether the backbone has adapters."""
    return any(hasattr(module, "lora_A") for module in model.backbone.modules())


def factor_shapes(model: MergeVLA, settings: LoraSettings) -> dict[str, tuple[int, ...]]:
    """Return the shapes of the factors that `add_lora` would add, by their names: `<layer>.lora_A`, `<layer>.lora_B`.

    Raises LoraError if the rank exceeds the network's width.
    """
    shapes: dict[str, tuple[int, ...]] = {}
    for name, (out, *inputs) in _adapted(model, settings).items():
        shapes[f"{BACKBONE}{name}.lora_A"] = (settings.rank, *inputs)
        shapes[f"{BACKBONE}{name}.lora_B"] = (out, settings.rank, *(1 for _ in inputs[1:]))
    return shapes


def _adapted(model: MergeVLA, settings: LoraSettings) -> dict[str, torch.Size]:
    """Return the backbone's layers that have adapters, with the shapes of their weights."""
    if settings.rank > model.architecture.width:
        raise LoraError(f"expected a LoRA rank of 1 to {model.architecture.width}, got {settings.rank}")
    kinds = (nn.Linear, nn.Conv2d) if settings.convolutions else (nn.Linear,)
    return {name: module.weight.shape for name, module in model.backbone.named_modules() if isinstance(module, kinds)}


def lora_factors(tensors: Mapping[str, Tensor], settings: LoraSettings) -> dict[str, Factors]:
    """Return the adapters among a checkpoint's tensors, by the names of their weights in the plain network."""
    layers = [name.removesuffix(".lora_A") for name in tensors if name.endswith(".lora_A")]
    return {
        f"{layer}.weight": Factors(
            tensors[f"{layer}.lora_A"],
            tensors[f"{layer}.lora_B"],
            settings.alpha / settings.rank,
            tensors[f"{layer}.weight"].shape,
        )
        for layer in layers
    }


def plain_name(name: str) -> str:
    """Return a weight's name in the plain network; factors are named `<layer>.lora_A` and `<layer>.lora_B`."""
    return re.sub(rf"(\.lora_[AB])\.{ADAPTER}\.weight$", r"\1", name).replace(".base_layer.", ".")


def folded(tensors: Mapping[str, Tensor], settings: LoraSettings) -> dict[str, Tensor]:
    """Return the weights of a network without adapters that computes the same: W + scale * B A, summed in fp32."""
    weights = {name: tensor for name, tensor in tensors.items() if ".lora_" not in name}
    for name, factors in lora_factors(tensors, settings).items():
        weights[name] = (weights[name].float() + factors.delta()).to(weights[name].dtype)
    return weights
