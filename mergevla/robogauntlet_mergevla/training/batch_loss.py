"""The loss of a batch of demonstrations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import combinations

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import normalize

from robogauntlet.policies.training.dataset import Batch
from robogauntlet_mergevla.network.config import Architecture
from robogauntlet_mergevla.network.model import MergeVLA
from robogauntlet_mergevla.network.normalisation import TaskStatistics, padded
from robogauntlet_mergevla.network.tokenizer import Prompts, Tokenizer

TEMPERATURE = 0.1
"""Of the cosines in `contrastive_loss`."""


class Objective(StrEnum):
    """What a training minimises."""

    L1 = "l1"
    """The L1 of the normalised actions."""
    MATCHING = "matching"
    """A contrastive loss of the backbone alone, which reads no action: see `BatchLoss.loss`."""

    @property
    def label(self) -> str:
        """How progress names it."""
        return "L1" if self is Objective.L1 else "matching loss"


def masked_l1(predicted: Tensor, target: Tensor, mask: Tensor) -> Tensor:
    """Mean absolute difference of chunks (B, chunk, numbers) where `mask`, of the same shape, is true."""
    counted = mask.to(predicted.dtype)
    return ((predicted - target).abs() * counted).sum() / counted.sum().clamp(min=1.0)


def contrastive_loss(one: Tensor, other: Tensor, matches: Tensor) -> Tensor:
    """The mean -log of the probability that a row of one side finds a match on the other, both ways.

    Probabilities are the softmax of cosines: InfoNCE (A. van den Oord et al., arXiv 1807.03748) as in CLIP
    (A. Radford et al., arXiv 2103.00020), with all matches of a row added up.

    Args:
        one: Embeddings, shape (n, width).
        other: Embeddings, shape (n, width).
        matches: Which row of `one` matches which row of `other`, bool, shape (n, n); every row and column has one.
    """
    scores = normalize(one, dim=-1) @ normalize(other, dim=-1).T / TEMPERATURE
    found = scores.masked_fill(~matches, -torch.inf)
    return sum(((scores.logsumexp(side) - found.logsumexp(side)).mean() for side in (0, 1)), scores.new_zeros(())) / 2


@dataclass(frozen=True)
class BatchLoss:
    """Computes the loss of a network on a batch."""

    architecture: Architecture
    statistics: TaskStatistics
    tokenizer: Tokenizer
    device: torch.device
    objective: Objective = Objective.L1

    def loss(self, model: MergeVLA, batch: Batch) -> Tensor:
        """The mean L1 of the model's normalised chunks, without steps past the end and numbers not in the task.

        With `Objective.MATCHING`: the mean contrastive loss over pairs of the cameras' images and the sentence, each
        embedded on its own. Images of one frame match, and a sentence matches the images of all frames that have it.
        """
        pixels = np.stack([batch.images[camera] for camera in self.architecture.cameras], axis=1)
        images = torch.from_numpy(pixels).to(self.device).permute(0, 1, 4, 2, 3).float() / 255.0
        if self.objective is Objective.MATCHING:
            return self._matching(model, images, batch.instructions)
        proprioception = padded(batch.states, self.architecture.proprioception_dim)
        states = self._tensor(self.statistics.normalise_proprioception(batch.tasks, proprioception))
        actions = padded(batch.actions, self.architecture.action_dim)
        target = self._tensor(self.statistics.normalise_actions(batch.tasks, actions))
        used = self.statistics.is_used(batch.tasks, self.architecture.action_dim)
        mask = torch.from_numpy(batch.mask[..., None] & used[:, None]).to(self.device)
        return masked_l1(model(images, self._prompts(batch.instructions), states), target, mask)

    def _matching(self, model: MergeVLA, images: Tensor, instructions: Sequence[str]) -> Tensor:
        cameras, blank = images.shape[1], [""] * len(images)
        alone = [torch.zeros_like(images) for _ in range(cameras + 1)]
        for camera, shown in enumerate(alone[:cameras]):
            shown[:, camera] = images[:, camera]
        prompts = self._prompts([*blank * cameras, *instructions])
        embedded = model.hidden_states(torch.cat(alone), prompts).action[-1].mean(dim=1).chunk(cameras + 1)
        numbers = torch.tensor([instructions.index(text) for text in instructions], device=self.device)
        same_frame = torch.eye(len(images), dtype=torch.bool, device=self.device)
        same_sentence = numbers[:, None] == numbers
        pairs = list(combinations(range(cameras + 1), 2))
        losses = [
            contrastive_loss(embedded[a], embedded[b], same_sentence if b == cameras else same_frame) for a, b in pairs
        ]
        return torch.stack(losses).mean()

    def _prompts(self, instructions: Sequence[str]) -> Prompts:
        return without_empty_columns(self.tokenizer(instructions)).to(self.device)

    def _tensor(self, values: np.ndarray) -> Tensor:
        return torch.from_numpy(values).float().to(self.device)


def without_empty_columns(prompts: Prompts) -> Prompts:
    """Remove columns that are padding in every row: they change no result, but take time."""
    used = prompts.present.any(dim=0)
    return Prompts(prompts.ids[:, used], prompts.present[:, used])
