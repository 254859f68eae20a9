"""Settings of a training, and the course of its learning rate."""

from __future__ import annotations

import math
from dataclasses import asdict
from enum import StrEnum
from typing import Annotated, ClassVar

from pydantic import Field, NonNegativeInt, PositiveFloat, PositiveInt
from pydantic.dataclasses import dataclass

from robogauntlet.policies.stored import STRICT, Stored
from robogauntlet_mergevla.training.training_checkpoint import TrainingError


class Schedule(StrEnum):
    """Course of the learning rate after the warm-up."""

    COSINE = "cosine"
    """Half a cosine down to zero (arXiv 1608.03983, without restarts)."""
    CONSTANT = "constant"
    """The schedule of the paper's released code, in effect."""


def rate_at(step: int, *, steps: int, warm_up: int, schedule: Schedule) -> float:
    """Share of the full learning rate in a step, counted from 0; the warm-up rises linearly."""
    if step < warm_up:
        return (step + 1) / (warm_up + 1)
    if schedule is Schedule.CONSTANT:
        return 1.0
    done = (step - warm_up) / max(steps - warm_up, 1)
    return 0.5 * (1.0 + math.cos(math.pi * done))


@dataclass(frozen=True, config=STRICT)
class Settings(Stored):
    """Training settings. All but `save_s` and `threads` decide the weights."""

    what: ClassVar = "training settings"
    refusal: ClassVar = TrainingError

    steps: PositiveInt = 2000
    batch_size: Annotated[int, Field(gt=0, le=100_000)] = 32
    learning_rate: Annotated[float, Field(gt=0.0, lt=1.0)] = 1e-3
    warm_up: NonNegativeInt = 50
    """Steps in which the learning rate rises."""
    schedule: Schedule = Schedule.COSINE
    weight_decay: float = 0.01
    clip: PositiveFloat = 1.0
    """Largest norm of the gradient."""
    largest_shift: Annotated[int, Field(ge=0, le=1024)] = 4
    """Augmentation: largest shift of an image (px)."""
    changed_words: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """Augmentation: share of an instruction's words that are left out, replaced or followed by another."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    evaluate_every: PositiveInt = 250
    """Steps between evaluations of the held-out episodes."""
    save_s: float = 60.0
    """Time between two writes of the state file (s)."""
    threads: Annotated[int, Field(gt=0, le=1024)] = 1

    @property
    def decisive(self) -> dict[str, object]:
        """The settings that decide the weights, as plain JSON; words only if they are changed."""
        idle = {"save_s", "threads"} | (set() if self.changed_words else {"changed_words"})
        return {name: value for name, value in asdict(self).items() if name not in idle}
