"""What a person asked for, as settings, or one line about what cannot be."""

from __future__ import annotations

from policies.mergevla.config import SIZES, Architecture
from policies.training.finetune import Settings
from policies.training.schedule import Schedule
from policies.training.state import TrainingError


def architecture_named(name: str) -> Architecture:
    """The architecture of this name.

    Raises:
        TrainingError: There is none.
    """
    if name not in SIZES:
        raise TrainingError(f"expected a size out of {', '.join(SIZES)}, got '{name}'")
    return SIZES[name]


def settings_of(
    steps: int, batch_size: int, learning_rate: float, schedule: str, shift: int, seed: int, threads: int
) -> Settings:
    """Settings of a command line's options.

    Raises:
        TrainingError: A value that cannot be.
    """
    if schedule not in list(Schedule):
        raise TrainingError(f"expected a schedule out of {', '.join(Schedule)}, got '{schedule}'")
    return Settings(
        steps=steps,
        batch_size=batch_size,
        learning_rate=learning_rate,
        schedule=Schedule(schedule),
        largest_shift=shift,
        seed=seed,
        threads=threads,
    )
