"""How long a policy's answers take in simulated time, and what the robot does meanwhile. Standard library only.

Modelled, not measured while playing: equal episodes have equal answer times on every machine and under any load.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

WAITS = "waits"
"""The simulation waits for answers, as if they took no time."""
MEASURED = "measured"
"""Stands for a latency that `robogauntlet run` measures first, on its command line alone."""
MAX_MS = 60_000.0
"""Longest answer time (ms)."""
_P95 = 1.6448536269514722
"""95th percentile of the standard normal distribution."""
_TEXT = re.compile(r"(?:(?P<mode>[a-z]+):)?(?P<median>\d+(?:\.\d+)?)(?:-(?P<p95>\d+(?:\.\d+)?))?\s?ms")
EXPECTED = (
    "expected waits, 80ms, 80-140ms (median and 95th percentile), or one of these after hold:, continue: or blend:"
)


class TimingMode(StrEnum):
    """What the robot does until the answer arrives."""

    HOLD = "hold"
    """It stays where it is, with its gripper as last commanded, and then executes the answer from its beginning."""
    CONTINUE = "continue"
    """It executes the rest of the last answer, and then the new one from the action that is due at that time. When
    the rest is used up, or before the first answer, it holds."""
    BLEND = "blend"
    """As `continue`; where both answers have an action for a time, their average, of which the new one's share grows
    evenly. Grippers follow the new one."""


@dataclass(frozen=True, slots=True)
class Timing:
    """The time that answers take, and what the robot does meanwhile.

    Raises:
        ValueError: A time is not above 0 and up to `MAX_MS`, or the percentile is not above the median.
    """

    mode: TimingMode
    median_ms: float
    """Median of the answer times (ms); all of them, without `p95_ms`."""
    p95_ms: float | None = None
    """95th percentile (ms). The times have a lognormal distribution, drawn for each pair and query."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        for value in (self.median_ms, *([] if self.p95_ms is None else [self.p95_ms])):
            if not 0 < value <= MAX_MS:
                raise ValueError(f"expected a latency above 0 and up to {MAX_MS:g} ms, got {value:g}")
        if self.p95_ms is not None and self.p95_ms <= self.median_ms:
            raise ValueError(
                f"expected a 95th percentile above the median of {self.median_ms:g} ms, got {self.p95_ms:g}"
            )

    def __str__(self) -> str:
        spread = "" if self.p95_ms is None else f"-{self.p95_ms:g}"
        return f"{self.mode}:{self.median_ms:g}{spread}ms"

    def latency_ms(self, normal: float) -> float:
        """Return the answer time (ms) for a draw from the standard normal distribution."""
        if self.p95_ms is None:
            return self.median_ms
        return self.median_ms * math.exp(normal / _P95 * math.log(self.p95_ms / self.median_ms))


def is_measured(latency: str | None) -> bool:
    """Whether a text of the command line asks for a measurement: `measured`, or `MODE:measured`."""
    return latency is not None and latency.rpartition(":")[2] == MEASURED


def read_timing(value: Any) -> Timing | None:
    """Return the timing of a text or mapping, as suites and the command line give it; None if the simulation waits.

    Texts: see `EXPECTED`. Mappings: `{mode: continue, latency_ms: 80}`, where the latency may be a mapping with
    `median` and `p95`. The mode is `hold` by default. A latency of 0 is that of a simulation that waits.

    Raises:
        ValueError: It is something else; the message says what was expected.
    """
    if value is None or value == WAITS or isinstance(value, Timing):
        return None if value == WAITS else value
    mode, median, p95 = _text(value) if isinstance(value, str) else _mapping(value)
    if mode not in (None, WAITS, *TimingMode) or (mode == WAITS and median):
        raise ValueError(f"mode: expected {', '.join(TimingMode)}, or {WAITS} without a latency; got {mode!r}")
    if median == 0 and p95 is None:
        return None
    return Timing(TimingMode(mode or TimingMode.HOLD), median, p95)


def _text(value: str) -> tuple[Any, float, float | None]:
    if is_measured(value):
        raise ValueError(f"expected a time, got '{value}': answers are measured by robogauntlet run --latency alone")
    match = _TEXT.fullmatch(value)
    if match is None:
        raise ValueError(f"{EXPECTED}; got '{value}'")
    return match["mode"], float(match["median"]), None if match["p95"] is None else float(match["p95"])


def _mapping(value: Any) -> tuple[Any, float, float | None]:
    if not isinstance(value, Mapping) or not value.keys() <= {"mode", "latency_ms"}:
        raise ValueError(f"{EXPECTED}, or {{mode: hold, latency_ms: 80}}; got {value!r}")
    latency = value.get("latency_ms", 0 if value.get("mode") == WAITS else None)
    has_spread = isinstance(latency, Mapping) and latency.keys() == {"median", "p95"}
    median, p95 = (latency["median"], latency["p95"]) if has_spread else (latency, None)
    if any(isinstance(one, bool) or not isinstance(one, int | float) for one in (median, 0 if p95 is None else p95)):
        raise ValueError(f"latency_ms: expected a number, or {{median: 80, p95: 140}}; got {latency!r}")
    return value.get("mode"), float(median), None if p95 is None else float(p95)
