"""Several experts merged into one model: a shared backbone and trunk, masks, and a head for each task."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain

import torch
from torch import Tensor

from robogauntlet.policies.contract import PolicyError
from robogauntlet_mergevla.checkpoints.expert_copies import Copy
from robogauntlet_mergevla.merging.errors import ExpertsDiffer
from robogauntlet_mergevla.merging.merge import MergedTaskVectors
from robogauntlet_mergevla.merging.recipe import Recipe
from robogauntlet_mergevla.merging.task_vectors import Weights, difference
from robogauntlet_mergevla.network.backbone import HiddenStates
from robogauntlet_mergevla.network.config import Architecture
from robogauntlet_mergevla.network.lora import BACKBONE, Factors
from robogauntlet_mergevla.network.model import MergeVLA, assembled
from robogauntlet_mergevla.network.model_cache import ModelCache
from robogauntlet_mergevla.network.normalisation import TaskStatistics
from robogauntlet_mergevla.network.tokenizer import tokenizer_for

SUBSPACE = 8
"""Right singular vectors of an expert's own value projections that are kept for a router (arXiv 2511.18810: k_r)."""


@dataclass(frozen=True, eq=False)
class MergedWeights:
    """All weights and settings of a merged model. Names are those of the plain network."""

    architecture: Architecture
    statistics: TaskStatistics
    """Normalisation statistics of each expert, in the experts' order."""
    tasks: Mapping[str, tuple[str, ...]]
    """Expert to the tasks that it was trained on (`simulator/task`); a task has one expert."""
    instructions: Mapping[str, str]
    """Task to its instruction."""
    recipe: Recipe
    base: Weights
    """Theta_0: all weights of the base."""
    merged: MergedTaskVectors
    """Merged task vectors of the backbone, and of the trunk under `TrunkRule.VECTORS`."""
    trunk: Weights
    """The mean of the trunks under `TrunkRule.MEAN`, else empty."""
    adapters: Mapping[str, Mapping[str, Factors]]
    """Expert to its adapters if backbones are not merged, else empty."""
    heads: Mapping[str, Weights]
    """Expert to the weights that it keeps: the last k blocks, and the output layer unless that is merged."""
    subspaces: Mapping[str, tuple[Tensor, Tensor]]
    """Expert to the `leading` parts of its own value projections (v_adapter, v_task) in the last merged block."""
    expert_digests: Mapping[str, str] = field(default_factory=dict)
    """Expert to the digest of the checkpoint that was merged."""
    copies: Mapping[str, Copy] = field(default_factory=dict)
    """Expert to the quantised form of `adapters` and `heads` under `Recipe.stored_bits`, else empty."""
    trunk_copy: Copy = field(default_factory=dict)
    """The quantised form of `trunk` under `Recipe.stored_bits`, else empty."""
    action_steps: Mapping[str, int] = field(default_factory=dict)
    """Expert to its `CheckpointMetadata.action_steps`; those that execute whole chunks are left out."""

    def __post_init__(self) -> None:
        experts = self.statistics.tasks
        for names in (self.merged.experts, self.heads, self.subspaces, self.tasks, self.adapters or experts):
            if set(names) != set(experts):
                raise ExpertsDiffer(f"expected the experts {', '.join(experts)} in all parts, got {', '.join(names)}")
        for weights in (self.merged.vector, self.trunk, *self.heads.values()):
            if problem := difference({name: self.base[name] for name in weights if name in self.base}, weights):
                raise ExpertsDiffer(f"expected weights of the base's names and shapes: {problem}")
        trained = {name for name in self.base if not name.startswith(BACKBONE)}
        for expert, head in self.heads.items():
            if missing := sorted(trained - self.merged.vector.keys() - self.trunk.keys() - head.keys()):
                raise ExpertsDiffer(f"expert {expert}: expected {missing[0]} to be merged or kept, it is neither")

    @cached_property
    def expert_of(self) -> Mapping[str, str]:
        """Task to its expert."""
        return {task: expert for expert, tasks in self.tasks.items() for task in tasks}

    @property
    def task_statistics(self) -> TaskStatistics:
        """Normalisation statistics of each task, those of its expert."""
        return TaskStatistics({task: self.statistics.of(expert) for task, expert in self.expert_of.items()})


class MergedModel:
    """A merged model: builds the network of each expert on first use. An unknown expert raises ExpertsDiffer."""

    def __init__(self, parts: MergedWeights, *, device: torch.device | None = None) -> None:
        self.parts = parts
        self.architecture = parts.architecture
        self.experts = parts.statistics.tasks
        self.tasks, self.expert_of = parts.tasks, parts.expert_of
        self.instructions = parts.instructions
        self.kept_blocks = parts.recipe.kept_blocks
        self.device = device or torch.device("cpu")
        self.tokenizer = tokenizer_for(parts.architecture)
        self._models: ModelCache[str | None, MergeVLA] = ModelCache(
            self._built, lambda model: model.state_dict().values(), device=self.device, shared=parts.base.values()
        )

    def weights(self, expert: str | None) -> dict[str, Tensor]:
        """Return the weights of an expert's network, of the base's types; None for those of the base."""
        parts = self.parts
        if expert is None:
            return dict(parts.base)
        self._check(expert)
        adapters = ((name, factors.delta()) for name, factors in parts.adapters.get(expert, {}).items())
        weights = dict(parts.base)
        for name, delta in chain(parts.merged.of(expert).items(), adapters):  # summed in fp32, rounded once
            weights[name] = (weights[name].float() + delta).to(weights[name].dtype)
        for name, weight in {**parts.trunk, **parts.heads[expert]}.items():
            weights[name] = weight.to(weights[name].dtype)
        return weights

    def model(self, expert: str | None) -> MergeVLA:
        """Return the network of an expert in evaluation mode; None for the base."""
        return self._models(expert)

    def _built(self, expert: str | None) -> MergeVLA:
        with torch.inference_mode(False):
            model = assembled(self.architecture, self.weights(expert))
            return model.requires_grad_(False).eval().to(self.device)

    @torch.inference_mode()
    def hidden_states(self, expert: str | None, images: Tensor, instructions: Sequence[str]) -> HiddenStates:
        """Compute (h_T, h_A) of every layer of an expert's backbone; None for the base's.

        Images are of shape (B, cameras, 3, H, W), in [0, 1], with B instructions, empty where it is hidden. Raises
        PolicyError if a shape is not the architecture's.
        """
        if len(images) != len(instructions):
            raise PolicyError(f"expected an instruction for each of {len(images)} images, got {len(instructions)}")
        prompts = self.tokenizer(instructions).to(self.device)
        return self.model(expert).hidden_states(images.to(self.device), prompts)

    def projections(self, expert: str, block: int) -> dict[str, Tensor]:
        """Return k_adapter, k_task, v_adapter and v_task, each (width, width), of a block of an expert's network.

        The block, from 0, is as it is after merging: the expert's own if the block is kept.
        """
        layer = self.model(self._check(expert)).action_expert.blocks[block]
        return {name: getattr(layer, name).weight for name in ("k_adapter", "k_task", "v_adapter", "v_task")}

    def own_value_weights(self, expert: str) -> tuple[Tensor, Tensor]:
        """Return (v_adapter, v_task) of the expert's last merged block, L - k - 1 from 0, before it was merged.

        Each of shape (SUBSPACE or the width, width): with the leading singular values and right singular vectors of the
        whole projection, since nothing else of it is stored.
        """
        adapter, task = self.parts.subspaces[self._check(expert)]
        return adapter.to(self.device), task.to(self.device)

    def _check(self, expert: str) -> str:
        if expert not in self.experts:
            raise ExpertsDiffer(f"expected one of the merged experts {', '.join(self.experts)}, got {expert}")
        return expert


def leading(projection: Tensor) -> Tensor:
    """Return diag(s) V^T of the leading singular triplets, shape (at most SUBSPACE, inputs), fp32."""
    _, values, vectors = torch.linalg.svd(projection.detach().float(), full_matrices=False)
    return (values[:SUBSPACE, None] * vectors[:SUBSPACE]).contiguous()
