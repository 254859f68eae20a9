"""What a person asked for, as settings, or one line about what cannot be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

from policies.mergevla.config import SIZES, Architecture, Quirks
from policies.training.finetune import Settings
from policies.training.schedule import Schedule
from policies.training.state import TrainingError
from suites.plugins import nearest

ALL_QUIRKS = "paper"
"""Stands for every quirk of the paper's released code."""
GATES = {"sigmoid": False, "tanh": True}


def architecture_of(
    size: str, quirks: Sequence[str] = (), self_attention: bool = False, gate: str | None = None
) -> Architecture:
    """The architecture of this size, or a variant of it.

    Args:
        size: Name out of `config.SIZES`.
        quirks: Names out of `config.Quirks`, or `ALL_QUIRKS`.
        self_attention: VLA-Adapter's blocks, the paper's negative control.
        gate: `sigmoid` or `tanh`; None for the block's own.

    Raises:
        TrainingError: There is no such size, quirk or gate.
    """
    if size not in SIZES:
        raise TrainingError(f"expected a size out of {', '.join(SIZES)}, got '{size}'")
    known = [quirk.name for quirk in fields(Quirks)]
    for quirk in quirks:
        if quirk not in (ALL_QUIRKS, *known):
            raise TrainingError(f"unknown quirk '{quirk}'{nearest(quirk, (ALL_QUIRKS, *known))}")
    if gate is not None and gate not in GATES:
        raise TrainingError(f"expected a gate out of {', '.join(GATES)}, got '{gate}'")
    architecture = SIZES[size]
    return replace(
        architecture,
        quirks=Quirks.paper() if ALL_QUIRKS in quirks else Quirks(**dict.fromkeys(quirks, True)),
        expert=replace(
            architecture.expert, self_attention=self_attention, tanh_gate=None if gate is None else GATES[gate]
        ),
    )


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
