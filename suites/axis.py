"""A perturbation axis: what it changes, and its levels in a physical unit. Standard library only."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum


class Changes(StrEnum):
    """What an axis changes. Everything else is checked to stay as in the clean episode."""

    CAMERAS = "cameras"
    """Pose and field of view of the cameras, in simulators that allow it."""
    IMAGES = "images"
    """The delivered images, by the same operator in every simulator."""
    ACTIONS = "actions"
    """The executed actions, by the same operator in every simulator."""
    INSTRUCTION = "instruction"
    LIGHTS = "lights"
    TABLE = "table"
    """The appearance of the table, and distractors on it that cannot be touched."""
    OBJECTS = "objects"
    ARM = "arm"
    """The start pose of the arm."""
    DYNAMICS = "dynamics"
    """Mass and friction of the task's objects."""
    STARTS = "starts"
    """Where a task that starts in stored states starts."""
    NOTHING = "nothing"

    @property
    def starts_clean(self) -> bool:
        """Whether the episode starts from the physical state of the clean one."""
        return self not in (Changes.OBJECTS, Changes.ARM, Changes.STARTS)


@dataclass(frozen=True, slots=True)
class Axis:
    """One perturbation axis."""

    name: str
    """The only name of the axis, in suites and reports."""
    changes: Changes
    summary: str
    references: str
    """Published perturbations that the levels are aligned with."""
    unit: str = "control"
    levels: tuple[float, ...] = (1.0,)
    """The value at severity 1 (mild) to 5 (extreme). A control has one value."""
    tolerance: float = 0.0
    """Largest difference between requested and delivered value in an episode (same unit). Infinite if one episode is
    too short to measure it, or it has no measure."""
    secondary_levels: tuple[float, ...] = ()
    """A second quantity that changes with the severity, explained in the summary."""
    unchanged: float | None = 0.0
    """The value in the clean episode, from which severities below 1 are interpolated. None for an axis whose levels are
    kinds or counts, which has whole severities only."""
    incomparable: str = ""
    """Why an equal severity is another perturbation in another simulator; empty if it is the same."""
    ordered: bool = True
    """Whether a higher severity is more of the same, as trends, areas and the severity of half the loss assume."""

    def value(self, severity: float) -> float:
        """Return the level of a severity above 0 and up to 5, in the axis' unit.

        Between whole severities the level is interpolated: linearly, and for a signal-to-noise ratio (whose clean value
        is infinite) linearly in the deviation of the noise.

        Raises:
            ValueError: The axis has no such severity.
        """
        return self._interpolated(self.levels, self.unchanged, severity)

    def secondary_value(self, severity: float) -> float:
        """Return the secondary level of a severity, 0 without one."""
        if not self.secondary_levels:
            return 0.0
        return self._interpolated(self.secondary_levels, None if self.unchanged is None else self.neutral, severity)

    @property
    def neutral(self) -> float:
        """The secondary level of the clean episode: 1 for a factor, else 0."""
        return 1.0 if self.unchanged == 1.0 else 0.0

    def _interpolated(self, levels: tuple[float, ...], unchanged: float | None, severity: float) -> float:
        if not 0 < severity <= len(levels):
            raise ValueError(f"expected a severity from 1 to {len(levels)} on axis '{self.name}', got {severity:g}")
        if severity == int(severity):
            return levels[int(severity) - 1]
        if unchanged is None:
            raise ValueError(f"axis '{self.name}' has whole severities only, got {severity:g}")
        points = (unchanged, *levels)
        below, above = points[int(severity)], points[int(severity) + 1]
        share = severity - int(severity)
        if math.isinf(unchanged):  # dB: its amplitude is interpolated
            low, high = (10 ** (-point / 20) for point in (below, above))
            return -20 * math.log10(low + share * (high - low))
        return below + share * (above - below)

    def describe(self, severity: float) -> str:
        """Return the level of a severity with its unit, `18.4 dB PSNR` or `rewording type 2`."""
        level = f"{self.value(severity):.4g}"
        return f"{self.unit} {level}" if self.changes is Changes.INSTRUCTION else f"{level} {self.unit}"
