"""Whole networks added with weights, part by part: an expert and its base, or several experts of one base."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.func import functional_call

from robogauntlet.policies.training.dataset import Batch
from robogauntlet_mergevla.checkpoints.expert_checkpoint import load_verified, save_checkpoint
from robogauntlet_mergevla.checkpoints.metadata import METADATA_FILE, CheckpointMetadata
from robogauntlet_mergevla.merging.parts import is_merged
from robogauntlet_mergevla.network.lora import folded
from robogauntlet_mergevla.network.model import MergeVLA, assembled
from robogauntlet_mergevla.network.normalisation import TaskStatistics
from robogauntlet_mergevla.network.tokenizer import tokenizer_for
from robogauntlet_mergevla.training.batch_loss import BatchLoss
from robogauntlet_mergevla.training.dataset_mixture import DatasetMixture
from robogauntlet_mergevla.training.lambda_selection import held_out_l1
from robogauntlet_mergevla.zoo import shipped
from studies.percent import few

BASE = "zoo:base"
STEPS = 100
"""Steps in which coefficients are learned."""
Weights = Mapping[str, Tensor]


@dataclass(frozen=True, eq=False)
class Whole:
    """A network without adapters, and its metadata."""

    weights: Weights
    metadata: CheckpointMetadata

    @classmethod
    def read(cls, reference: str | Path) -> Whole:
        """Read a checkpoint and add its adapters to the weights."""
        tensors, metadata = load_verified(reference)
        return cls(folded(tensors, metadata.lora) if metadata.lora else tensors, metadata)


def interpolated(base: Weights, expert: Weights, share: float, only: Collection[str] = ()) -> dict[str, Tensor]:
    """Base + share * (expert - base) in the parts `only`, or in all without any; the expert's own weights elsewhere."""
    return {
        name: torch.lerp(base[name].float(), weight.float(), share) if is_merged(name, only) else weight
        for name, weight in expert.items()
    }


def added(experts: Sequence[Weights], shares: Sequence[float]) -> dict[str, Tensor]:
    """Sum of share * expert over all weights, in fp32."""
    return {
        name: sum(share * expert[name].float() for share, expert in zip(shares, experts, strict=True))
        for name in experts[0]
    }


def save(folder: Path, weights: Weights, metadata: CheckpointMetadata, statistics: TaskStatistics) -> None:
    """Write a network beside the zoo's base, unless the folder has it."""
    if (folder / METADATA_FILE).exists():
        return
    model = assembled(metadata.architecture, weights)
    plain = replace(metadata, lora=None, base=None, base_hash=None, metrics={}, statistics=statistics)
    save_checkpoint(folder, model, plain, shipped(BASE))


class _Sum:
    """A network whose weights are a sum that depends on logits of its shares."""

    def __init__(self, model: MergeVLA, stacks: Weights, logits: Tensor) -> None:
        self.architecture, self._model, self._stacks, self._logits = model.architecture, model, stacks, logits

    def __call__(self, *inputs: Any) -> Tensor:
        shares = self._logits.softmax(0)
        weights = {name: torch.tensordot(shares, stack, 1) for name, stack in self._stacks.items()}
        out: Tensor = functional_call(self._model, weights, inputs)
        return out


def losses(experts: Sequence[Whole], statistics: TaskStatistics, mixture: DatasetMixture) -> list[float]:
    """Mean L1 of each network over the held-out episodes, each task counting alike."""
    return [loss_of(expert.weights, experts[0], statistics, mixture) for expert in experts]


def loss_of(weights: Weights, like: Whole, statistics: TaskStatistics, mixture: DatasetMixture) -> float:
    """Mean L1 of one network over the held-out episodes, each task counting alike."""
    model = assembled(like.metadata.architecture, weights).eval()
    by_task = held_out_l1(lambda task: model, statistics, mixture)
    return sum(by_task.values()) / len(by_task)


def shares_of(way: str, experts: Sequence[Whole], statistics: TaskStatistics, mixture: DatasetMixture) -> list[float]:
    """The coefficients of arXiv 2602.09021, on held-out episodes of the training data.

    `average`; `inverse-loss`, in proportion to 1 / loss; `learned`, a softmax by gradient descent on the loss;
    `greedy`, the mean of those that, added from the best on, lower the loss (as in arXiv 2203.05482).
    """
    count = len(experts)
    if way == "average":
        return [1 / count] * count
    if way == "learned":
        return _learned(experts, statistics, mixture)
    each = losses(experts, statistics, mixture)
    if way == "inverse-loss":
        return [1 / loss / sum(1 / other for other in each) for loss in each]
    order = sorted(range(count), key=each.__getitem__)
    chosen, best = order[:1], each[order[0]]
    for more in order[1:]:
        trial = [*chosen, more]
        mean = added([experts[one].weights for one in trial], [1 / len(trial)] * len(trial))
        if (loss := loss_of(mean, experts[0], statistics, mixture)) < best:
            chosen, best = trial, loss
    return [(one in chosen) / len(chosen) for one in range(count)]


def _learned(experts: Sequence[Whole], statistics: TaskStatistics, mixture: DatasetMixture) -> list[float]:
    architecture = experts[0].metadata.architecture
    model = assembled(architecture, experts[0].weights).eval()
    stacks = {name: torch.stack([one.weights[name].float() for one in experts]) for name in experts[0].weights}
    logits = torch.zeros(len(experts), requires_grad=True)
    network = _Sum(model, stacks, logits)
    batch_loss = BatchLoss(architecture, statistics, tokenizer_for(architecture), torch.device("cpu"))
    batches: list[Batch] = list(mixture.held_out(32, chunk_length=architecture.chunk_length))
    optimiser = torch.optim.Adam([logits], lr=0.1)
    order = torch.Generator().manual_seed(0)
    for _ in range(few(STEPS)):
        batch = batches[int(torch.randint(len(batches), (1,), generator=order))]
        optimiser.zero_grad()
        batch_loss.loss(network, batch).backward()  # type: ignore[arg-type]
        optimiser.step()
    shares: list[float] = logits.softmax(0).tolist()
    return shares
