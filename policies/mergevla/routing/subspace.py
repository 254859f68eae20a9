"""The paper's router (arXiv 2511.18810): energy of an expert's hidden states in subspaces of its value projections."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from robogauntlet.policies.contract import Routing
from robogauntlet.policies.mergevla.checkpoints.merged_model import MergedModel
from robogauntlet.policies.mergevla.network.backbone import HiddenStates
from robogauntlet.policies.mergevla.routing.contract import FirstObservation, answer, hidden_states

RANK = 8
"""k_r, the number of right singular vectors that span a subspace."""


@dataclass(frozen=True, eq=False)
class Subspaces:
    """Subspaces onto which one expert's hidden states are projected."""

    action: Tensor
    """P_A, leading right singular vectors of v_adapter, shape (8, width)."""
    task: Tensor
    """P_T, those of v_task, shape (8, width)."""

    @classmethod
    def of(cls, v_adapter: Tensor, v_task: Tensor) -> Subspaces:
        """Compute the subspaces of a block's value projections."""
        return cls(leading_right_vectors(v_adapter), leading_right_vectors(v_task))


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

    name: str

    def __init__(self, *, sees_instruction: bool = True) -> None:
        self.sees_instruction = sees_instruction
        self._fitted_to: MergedModel | None = None
        self._subspaces: dict[str, Subspaces] = {}

    def passes(self, experts: int) -> int:
        """Backbone passes for one decision: one per expert."""
        return experts

    def route(self, observations: Sequence[FirstObservation], model: MergedModel) -> list[Routing]:
        """Route by the raw scores r_m. The paper's softmax of them changes no choice and is not a probability."""
        if self._fitted_to is not model:
            self._subspaces = {expert: self._subspaces_of(model, expert) for expert in model.experts}
            self._fitted_to = model
        scores = {expert: self._scores(observations, model, expert) for expert in model.experts}
        return [answer({expert: values[i] for expert, values in scores.items()}) for i in range(len(observations))]

    def _scores(self, observations: Sequence[FirstObservation], model: MergedModel, expert: str) -> list[float]:
        scores: list[float] = []
        for hidden in hidden_states(model, expert, observations, sees_instruction=self.sees_instruction):
            scores += self._score(hidden, self._subspaces[expert], model.kept_blocks).tolist()
        return scores

    def _subspaces_of(self, model: MergedModel, expert: str) -> Subspaces:
        raise NotImplementedError

    def _score(self, hidden: HiddenStates, subspaces: Subspaces, kept_blocks: int) -> Tensor:
        raise NotImplementedError


class PaperCodedRouter(_SubspaceRouter):
    """The router of the released code.

    Expert m: r_m = (mean_tokens ||P_A,m h_A|| + mean_tokens ||P_T,m h_T||) / 2, with P of the expert's own, unmerged
    block of index b = L - k - 1 (from 0), and the hidden states of index b + 2 of that expert's backbone, one layer
    past those that this block reads. Like is projected onto like.
    """

    name = "paper-coded"

    def _subspaces_of(self, model: MergedModel, expert: str) -> Subspaces:
        return Subspaces.of(*model.own_value_weights(expert))

    def _score(self, hidden: HiddenStates, subspaces: Subspaces, kept_blocks: int) -> Tensor:
        layer = hidden_index(len(hidden.task) - 1, kept_blocks)
        return (energy(hidden.action[layer], subspaces.action) + energy(hidden.task[layer], subspaces.task)) / 2


class PaperWrittenRouter(_SubspaceRouter):
    """The router of the paper's text.

    Expert m: r_m = (||P_T h_A|| + ||P_A h_T||) / 2 at l = L, the pairs crossed, with P of the last block of the
    merged action expert as expert m runs it. The text does not say how tokens become one norm: their mean, as coded.
    """

    name = "paper-written"

    def _subspaces_of(self, model: MergedModel, expert: str) -> Subspaces:
        return Subspaces.of(*model.value_weights(expert)[-1])

    def _score(self, hidden: HiddenStates, subspaces: Subspaces, kept_blocks: int) -> Tensor:
        return (energy(hidden.action[-1], subspaces.task) + energy(hidden.task[-1], subspaces.action)) / 2


def hidden_index(layers: int, kept_blocks: int) -> int:
    """Return the index of the hidden states that the coded router reads: block index L - k - 1 plus 2.

    The code always keeps a block; with none, the index would be past the last, so the last is taken.
    """
    return min(layers - kept_blocks + 1, layers)
