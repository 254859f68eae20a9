"""The loss of a batch of demonstrations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from robogauntlet.policies.mergevla.network.config import Architecture
from robogauntlet.policies.mergevla.network.model import MergeVLA
from robogauntlet.policies.mergevla.network.normalisation import TaskStatistics
from robogauntlet.policies.mergevla.network.tokenizer import Prompts, Tokenizer
from robogauntlet.policies.training.dataset import Batch


def masked_l1(predicted: Tensor, target: Tensor, mask: Tensor) -> Tensor:
    """Mean absolute difference of chunks (B, chunk, 7) over the steps where `mask`, shape (B, chunk), is true."""
    wide = mask[..., None].to(predicted.dtype)
    return ((predicted - target).abs() * wide).sum() / (wide.sum() * predicted.shape[-1]).clamp(min=1.0)


@dataclass(frozen=True)
class BatchLoss:
    """Computes the loss of a network on a batch."""

    architecture: Architecture
    statistics: TaskStatistics
    tokenizer: Tokenizer
    device: torch.device

    def loss(self, model: MergeVLA, batch: Batch) -> Tensor:
        """The mean L1 of the model's normalised chunks, past the episode's end left out."""
        pixels = np.stack([batch.images[camera] for camera in self.architecture.cameras], axis=1)
        images = torch.from_numpy(pixels).to(self.device).permute(0, 1, 4, 2, 3).float() / 255.0
        states = self._tensor(self.statistics.normalise_proprioception(batch.tasks, batch.states))
        target = self._tensor(self.statistics.normalise_actions(batch.tasks, batch.actions))
        prompts = without_empty_columns(self.tokenizer(batch.instructions)).to(self.device)
        mask = torch.from_numpy(batch.mask).to(self.device)
        return masked_l1(model(images, prompts, states), target, mask)

    def _tensor(self, values: np.ndarray) -> Tensor:
        return torch.from_numpy(values).float().to(self.device)


def without_empty_columns(prompts: Prompts) -> Prompts:
    """Remove columns that are padding in every row: they change no result, but take time."""
    used = prompts.present.any(dim=0)
    return Prompts(prompts.ids[:, used], prompts.present[:, used])
