"""What the check of an adapter or of a policy has found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any


class Level(StrEnum):
    """How sure it is that something is wrong."""

    OK = "ok"
    NOTE = "note"
    """A fact that only the author can judge."""
    WARNING = "warning"
    """Probably a mistake."""
    FAILED = "failed"
    """Surely a mistake."""
    SKIPPED = "skipped"
    """The check does not apply, or could not run."""


@dataclass(frozen=True)
class Finding:
    """One finding, in one line."""

    topic: str
    """Of an adapter, the name of the check; of a policy, what it is about."""
    level: Level
    text: str = ""
    """What was seen; why a check was skipped."""
    numbers: Mapping[str, float] = field(default_factory=dict)
    """What was measured, by name; the unit is part of the name."""
    task: str = ""
    """`simulator/task` in which a promise of an adapter was checked."""
    expected: str = ""
    """The promise, if it is broken."""
    look: str = ""
    """Where to look for the mistake then."""

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> Finding:
        """Return what `dataclasses.asdict` has written, after JSON."""
        return cls(**{**plain, "level": Level(plain["level"])})

    def __str__(self) -> str:
        if self.expected:
            return f"{self.topic}: expected {self.expected}; seen: {self.text}; look at {self.look}"
        return f"{self.topic}: {self.level}" + (f": {self.text}" if self.text else "")


def percent(share: float) -> str:
    """Return a share as text, such as `43 %`."""
    return "less than 1 %" if 0 < share < 0.01 else f"{100 * share:.0f} %"
