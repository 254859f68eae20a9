"""The paper's router (arXiv 2511.18810): energy of an expert's hidden states in subspaces of its projections."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Self

import torch
from torch import Tensor

from robogauntlet.policies.contract import Routing
from robogauntlet_mergevla.checkpoints.merged_model import SUBSPACE, MergedModel
from robogauntlet_mergevla.network.backbone import HiddenStates
from robogauntlet_mergevla.routing.contract import FirstObservation, RoutingError, answer, hidden_states

RANK = 8
"""k_r, the number of right singular vectors that span a subspace."""
PROJECTIONS: Mapping[str, tuple[str, ...]] = {"v": ("v",), "k": ("k",), "kv": ("k", "v")}
"""Value of the option `projections` to the projections of a block: values, keys or both (the paper's Table 5)."""


@dataclass(frozen=True)
class SubspaceOptions:
    """Which subspaces the router projects onto."""

    projections: str = "v"
    """A key of `PROJECTIONS`. Of both, the score is the mean of the two, which the paper does not say."""
    rank: int = RANK
    block: int | None = None
    """Block of the action expert, from 0. By default the last that is merged (as coded), or the last (as written)."""

    @classmethod
    def read(cls, text: str) -> Self:
        """Read `projections=kv,rank=16,block=2`, in any order and number. Raises RoutingError for anything else."""
        values: dict[str, str | int] = {}
        for part in text.split(",") if text else ():
            name, _, value = part.partition("=")
            if name in values:
                raise RoutingError(f"expected each option once, got {name} twice")
            if name == "projections" and value in PROJECTIONS:
                values[name] = value
            elif name in ("rank", "block") and re.fullmatch("[0-9]{1,6}", value) and int(value) >= (name == "rank"):
                values[name] = int(value)
            else:
                known = "|".join(PROJECTIONS)
                raise RoutingError(
                    f"expected options projections={known}, rank=1 or more, block=0 or more, got '{part}'"
                )
        return cls(**values)  # type: ignore[arg-type]

    def check(self, model: MergedModel) -> None:
        """Raise RoutingError if the model has no such block, or fewer numbers than the rank."""
        blocks, width = model.architecture.language.layers, model.architecture.width
        if self.block is not None and self.block >= blocks:
            raise RoutingError(f"expected block=0 to {blocks - 1}, got {self.block}")
        if self.rank > width:
            raise RoutingError(f"expected rank=1 to {width}, got {self.rank}")


@dataclass(frozen=True, eq=False)
class Subspaces:
    """Subspaces onto which one expert's hidden states are projected."""

    action: Tensor
    """P_A, leading right singular vectors of v_adapter or k_adapter, shape (rank, width)."""
    task: Tensor
    """P_T, those of v_task or k_task, shape (rank, width)."""

    @classmethod
    def of(cls, adapter: Tensor, task: Tensor, rank: int = RANK) -> Subspaces:
        """Compute the subspaces of a block's projections."""
        return cls(leading_right_vectors(adapter, rank), leading_right_vectors(task, rank))


def leading_right_vectors(weight: Tensor, rank: int = RANK) -> Tensor:
    """The right singular vectors of the largest singular values, in fp32, shape (rank, width)."""
    return torch.linalg.svd(weight.detach().float(), full_matrices=False).Vh[:rank]


def energy(states: Tensor, subspace: Tensor) -> Tensor:
    """Mean over the tokens of ||P h||_2.

    The length of the projection does not depend on which orthonormal basis of the subspace P holds. Hidden states are
    of shape (B, tokens, width), P of shape (rank, width), the result of shape (B,).
    """
    return (states.float() @ subspace.to(states.device).mT).norm(dim=-1).mean(dim=-1)


class _SubspaceRouter:
    """Runs the backbone of every expert. The subspaces are computed once per model."""

    kind: str

    def __init__(self, options: SubspaceOptions = SubspaceOptions(), *, sees_instruction: bool = True) -> None:
        self.sees_instruction = sees_instruction
        self._options = options
        self._fitted_to: MergedModel | None = None
        self._subspaces: dict[str, list[Subspaces]] = {}

    @property
    def name(self) -> str:
        """The kind, and the options that are not the default ones."""
        default = SubspaceOptions()
        given = {name: value for name, value in vars(self._options).items() if value != getattr(default, name)}
        return ":".join(filter(None, (self.kind, ",".join(f"{name}={value}" for name, value in given.items()))))

    def passes(self, experts: int) -> int:
        """Backbone passes for one decision: one per expert."""
        return experts

    def route(self, observations: Sequence[FirstObservation], model: MergedModel) -> list[Routing]:
        """Route by the raw scores r_m. The paper's softmax of them changes no choice and is not a probability.

        Raises RoutingError for options that the model does not have.
        """
        if self._fitted_to is not model:
            self._options.check(model)
            self._subspaces = {expert: self._subspaces_of(model, expert) for expert in model.experts}
            self._fitted_to = model
        scores = {expert: self._scores(observations, model, expert) for expert in model.experts}
        return [answer({expert: values[i] for expert, values in scores.items()}) for i in range(len(observations))]

    def _scores(self, observations: Sequence[FirstObservation], model: MergedModel, expert: str) -> list[float]:
        scores: list[float] = []
        for hidden in hidden_states(model, expert, observations, sees_instruction=self.sees_instruction):
            each = [self._score(hidden, own, self._layer(model)).tolist() for own in self._subspaces[expert]]
            scores += [fmean(values) for values in zip(*each, strict=True)]
        return scores

    def _subspaces_of(self, model: MergedModel, expert: str) -> list[Subspaces]:
        weights = model.projections(expert, self._block(model))
        return [
            Subspaces.of(weights[f"{kind}_adapter"], weights[f"{kind}_task"], self._options.rank)
            for kind in PROJECTIONS[self._options.projections]
        ]

    def _block(self, model: MergedModel) -> int:
        """The block whose projections span the subspaces, from 0."""
        raise NotImplementedError

    def _layer(self, model: MergedModel) -> int:
        """Index of the hidden states that are projected."""
        raise NotImplementedError

    def _score(self, hidden: HiddenStates, subspaces: Subspaces, layer: int) -> Tensor:
        raise NotImplementedError


class PaperCodedRouter(_SubspaceRouter):
    """The router of the released code.

    Expert m: r_m = (mean_tokens ||P_A,m h_A|| + mean_tokens ||P_T,m h_T||) / 2, with P of the expert's own, unmerged
    block of index b = L - k - 1 (from 0), and the hidden states of index b + 2 of that expert's backbone, one layer
    past those that this block reads. Like is projected onto like. A checkpoint stores the leading parts of the value
    projections of this block alone; other subspaces are those of the expert's network after merging.
    """

    kind = "paper-coded"

    def _block(self, model: MergedModel) -> int:
        last = max(model.architecture.language.layers - model.kept_blocks - 1, 0)
        return last if self._options.block is None else self._options.block

    def _layer(self, model: MergedModel) -> int:
        layers = model.architecture.language.layers
        if self._options.block is None:
            return hidden_index(layers, model.kept_blocks)
        return min(self._options.block + 2, layers)

    def _subspaces_of(self, model: MergedModel, expert: str) -> list[Subspaces]:
        options = self._options
        if (options.projections, options.block) == ("v", None) and options.rank <= SUBSPACE:
            return [Subspaces.of(*model.own_value_weights(expert), options.rank)]
        return super()._subspaces_of(model, expert)

    def _score(self, hidden: HiddenStates, subspaces: Subspaces, layer: int) -> Tensor:
        return (energy(hidden.action[layer], subspaces.action) + energy(hidden.task[layer], subspaces.task)) / 2


class PaperWrittenRouter(_SubspaceRouter):
    """The router of the paper's text.

    Expert m: r_m = (||P_T h_A|| + ||P_A h_T||) / 2 at l = L, the pairs crossed, with P of the last block of the
    merged action expert as expert m runs it. The text does not say how tokens become one norm: their mean, as coded.
    """

    kind = "paper-written"

    def _block(self, model: MergedModel) -> int:
        return model.architecture.language.layers - 1 if self._options.block is None else self._options.block

    def _layer(self, model: MergedModel) -> int:
        return self._block(model) + 1

    def _score(self, hidden: HiddenStates, subspaces: Subspaces, layer: int) -> Tensor:
        return (energy(hidden.action[layer], subspaces.task) + energy(hidden.task[layer], subspaces.action)) / 2


def hidden_index(layers: int, kept_blocks: int) -> int:
    """Return the index of the hidden states that the coded router reads: block index L - k - 1 plus 2.

    The code always keeps a block; with none, the index would be past the last, so the last is taken.
    """
    return min(layers - kept_blocks + 1, layers)
