"""What the check of a policy has found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum


class Level(StrEnum):
    """How sure it is that something is wrong."""

    OK = "ok"
    NOTE = "note"
    """A fact that only the policy's author can judge."""
    WARNING = "warning"
    """Probably a mistake."""
    FAILED = "failed"
    """Surely a mistake."""


@dataclass(frozen=True)
class Finding:
    """One finding, in one line."""

    topic: str
    level: Level
    text: str
    numbers: Mapping[str, float] = field(default_factory=dict)
    """What was measured, by name; the unit is part of the name."""


def percent(share: float) -> str:
    """Return a share as text, such as `43 %`."""
    return "less than 1 %" if 0 < share < 0.01 else f"{100 * share:.0f} %"
