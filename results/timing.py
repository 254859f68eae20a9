"""Where the workers' time went, per simulator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd

PHASES = ("build", "load", "reset", "physics", "render", "inference", "rest", "wait")
"""In the order in which an episode goes through them; `rest` is what the clock saw and no phase accounts for."""
COLUMNS = ("worker", "build_s", "load_s", "reset_s", "physics_s", "render_s", "inference_s", "wait_s", "wall_s")
"""Fields of the record that are needed."""


@dataclass(frozen=True, slots=True)
class PhaseTiming:
    """Time of one simulator's workers, summed over all rows (errors included, for they took time too)."""

    simulator: str
    episodes: int
    workers: int
    """Worker processes that have a row; a recycled worker counts again if its name changed."""
    build_s: float
    """Importing the simulator and opening tasks (s)."""
    load_s: float
    """Loading policies (s)."""
    reset_s: float
    physics_s: float
    """Control steps (s)."""
    render_s: float
    """Observing (s)."""
    inference_s: float
    """In the policy (s)."""
    rest_s: float
    """Wall time of the episodes that is in none of reset, physics, render and inference (s)."""
    wait_s: float
    """Workers with nothing to do (s)."""
    wall_s: float
    """From the episodes' starts to their ends (s)."""

    @property
    def total_s(self) -> float:
        """Worker time: build + load + wall + wait (s)."""
        return self.build_s + self.load_s + self.wall_s + self.wait_s

    @property
    def busy_share(self) -> float | None:
        """Share of worker time after start-up in simulator or policy: (reset+physics+render+inference)/(wall+wait)."""
        after = self.wall_s + self.wait_s
        return (self.reset_s + self.physics_s + self.render_s + self.inference_s) / after if after > 0 else None

    @property
    def episodes_per_worker_hour(self) -> float | None:
        """Rows per hour of one worker's time."""
        return 3600 * self.episodes / self.total_s if self.total_s > 0 else None

    def seconds(self, phase: str) -> float:
        """Time in one of `PHASES` (s)."""
        return float(getattr(self, f"{phase}_s"))


def phase_timing(frame: pd.DataFrame) -> tuple[PhaseTiming, ...]:
    """Phase sums per simulator, in the order of the frame.

    Args:
        frame: Records with the columns `simulator` and `COLUMNS`.
    """
    if frame.empty:
        return ()
    times = list(COLUMNS[1:])
    groups = frame.groupby("simulator", observed=True, sort=False)
    sums, counts, workers = groups[times].sum(), groups.size(), groups["worker"].nunique()
    timings = []
    for simulator, line in sums.iterrows():
        inside = line["reset_s"] + line["physics_s"] + line["render_s"] + line["inference_s"]
        timings.append(
            PhaseTiming(
                simulator=str(simulator),
                episodes=int(counts[simulator]),
                workers=int(workers[simulator]),
                rest_s=max(float(line["wall_s"] - inside), 0.0),
                **{name: float(line[name]) for name in times},
            )
        )
    return tuple(timings)
