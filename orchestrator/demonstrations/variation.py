"""Draws the perturbations under which demonstrations are recorded, so that policies learn what does not matter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from robogauntlet.orchestrator.registry import why_impossible
from robogauntlet.suites.axes import AXES, why_exclusive
from robogauntlet.suites.conditions import read_condition, split_condition
from robogauntlet.suites.episode import AT, CLEAN, CONTROLS, Condition, Perturbation, content_hash
from robogauntlet.support.errors import BadInput

PRESENT = 0.5
"""Probability of each axis to be present in an episode."""
DEFAULT_SEVERITY = 2
NOT_VARIED = {
    CLEAN: "no axis",
    **dict.fromkeys(CONTROLS, "a control"),
    "instruction": "for evaluation: policies must not see its sentences",
}
"""What cannot be varied, and why: paraphrases of instructions are for evaluation alone."""


@dataclass(frozen=True)
class Variation:
    """Axes that are varied, and up to which severity."""

    highest: Mapping[str, float]

    @classmethod
    def read(cls, texts: Sequence[str]) -> Variation:
        """Read axes, each `AXIS` or `AXIS@SEVERITY`. Raises BadInput for one that cannot be varied."""
        highest: dict[str, float] = {}
        for text in texts:
            try:
                axis, severity = split_condition(text)
            except ValueError as error:
                raise BadInput(f"--vary {text}: {error}") from None
            if what := NOT_VARIED.get(axis):
                raise BadInput(f"--vary {text}: expected an axis to be varied, '{axis}' is {what}")
            (part,) = _parts(text if severity is not None else f"{axis}{AT}{DEFAULT_SEVERITY}", text)
            if axis in highest:
                raise BadInput(f"--vary {text}: expected each axis once, got '{axis}' twice")
            highest[axis] = part.severity
        return cls(highest)

    def condition(self, task: str, seed: int) -> Condition:
        """Return the condition of a seed's episode.

        Each axis that the task can have is present in half of the episodes, at a severity that is equally likely
        between 0 and the highest; of two that do not combine, the one that is drawn first stays.
        """
        generator = np.random.default_rng(int(content_hash(["vary", task, seed]), 16))
        drawn: list[Perturbation] = []
        for place in generator.permutation(len(self.highest)).tolist():
            axis, highest = list(self.highest.items())[place]
            present, level = generator.random(2).tolist()
            severity = round(level * highest, 2)
            if AXES[axis].unchanged is None:  # which has whole severities alone
                severity = 1 + int(level * int(highest))
            part = Perturbation(axis, severity)
            taken = why_exclusive([*(one.axis for one in drawn), axis])
            if present < PRESENT and severity and not taken and not why_impossible(Condition.of(part), task):
                drawn.append(part)
        return Condition.of(*drawn)


def _parts(text: str, given: str) -> tuple[Perturbation, ...]:
    try:
        condition = read_condition(text)
    except BadInput as error:
        raise BadInput(f"--vary {given}: {str(error).partition(': ')[2]}") from None
    if len(condition.perturbations) != 1:
        raise BadInput(f"--vary {given}: expected AXIS or AXIS@SEVERITY, such as camera-orbit@3")
    return condition.perturbations
