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

ANSWER_COLUMNS = ("query_p50_s", "query_p95_s", "query_max_s")
"""Fields of the record from which a policy's answering times are made; rows of older stores have none."""


@dataclass(frozen=True, slots=True)
class AnswerTiming:
    """How long a policy took to answer queries. Queries that were never answered are errors, and not among them."""

    policy: str
    episodes: int
    """Rows of which the times are known."""
    median_s: float
    """Median over the episodes of the episode's median (s)."""
    p95_s: float
    """Median over the episodes of the episode's 95th percentile (s)."""
    longest_s: float
    """Of all queries (s)."""


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


def answer_timing(frame: pd.DataFrame) -> tuple[AnswerTiming, ...]:
    """Answering times per policy, in the order of the frame; none for policies of which none are known.

    Args:
        frame: Records with the columns `policy` and, unless they are of an older export, `ANSWER_COLUMNS`.
    """
    if frame.empty or not set(ANSWER_COLUMNS) <= set(frame.columns):
        return ()
    known = frame[["policy", *ANSWER_COLUMNS]].dropna().astype(dict.fromkeys(ANSWER_COLUMNS, float))
    return tuple(
        AnswerTiming(
            policy=str(policy),
            episodes=len(rows),
            median_s=float(rows["query_p50_s"].median()),
            p95_s=float(rows["query_p95_s"].median()),
            longest_s=float(rows["query_max_s"].max()),
        )
        for policy, rows in known.groupby("policy", observed=True, sort=False)
    )
