"""Low-rank adapters on the backbone (arXiv 2106.09685, through `peft`), and their deltas to the weights."""

from __future__ import annotations

import re
from dataclasses import dataclass

import torch
from peft import LoraConfig, inject_adapter_in_model
from peft.tuners.lora import LoraLayer
from torch import Tensor, nn

from robogauntlet.policies.contract import PolicyError
from robogauntlet_mergevla.network.config import LoraSettings
from robogauntlet_mergevla.network.model import MergeVLA, assembled

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
    if settings.rank > model.architecture.width:
        raise LoraError(f"expected a LoRA rank of 1 to {model.architecture.width}, got {settings.rank}")
    kinds = (nn.Linear, nn.Conv2d) if settings.convolutions else (nn.Linear,)
    targets = [name for name, module in model.backbone.named_modules() if isinstance(module, kinds)]
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
    return any(isinstance(module, LoraLayer) for module in model.backbone.modules())


def lora_factors(model: MergeVLA) -> dict[str, Factors]:
    """Return the adapters by the names of their weights in the plain network."""
    factors = {}
    for name, module in model.backbone.named_modules():
        if isinstance(module, LoraLayer):
            a, b = module.lora_A[ADAPTER].weight, module.lora_B[ADAPTER].weight
            shape = module.get_base_layer().weight.shape
            factors[f"{BACKBONE}{name}.weight"] = Factors(a, b, module.scaling[ADAPTER], shape)
    return factors


def lora_deltas(model: MergeVLA) -> dict[str, Tensor]:
    """Return the adapters' deltas by weight, in fp32: the task vector of the backbone."""
    return {name: factors.delta() for name, factors in lora_factors(model).items()}


def plain_name(name: str) -> str:
    """Return a weight's name in the plain network; factors are named `<layer>.lora_A` and `<layer>.lora_B`."""
    return re.sub(rf"(\.lora_[AB])\.{ADAPTER}\.weight$", r"\1", name).replace(".base_layer.", ".")


def folded(model: MergeVLA) -> MergeVLA:
    """Return a copy without adapters that computes the same: each weight is W + scale * B A, summed in fp32.

    It shares all other weights, and is of the backbone's type.
    """
    weights = {plain_name(name): tensor for name, tensor in model.state_dict().items() if ".lora_" not in name}
    for name, delta in lora_deltas(model).items():
        weights[name] = (weights[name].float() + delta).to(weights[name].dtype)
    with torch.no_grad():
        return assembled(model.architecture, weights).train(model.training)
