"""Worker time per simulator and phase, and answer times of policies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd

PHASES = ("build", "load", "reset", "physics", "render", "inference", "rest", "wait")
"""In the order of an episode; `rest` is its time outside the other phases."""
COLUMNS = ("worker", "build_s", "load_s", "reset_s", "physics_s", "render_s", "inference_s", "wait_s", "wall_s")
"""Fields of the record that are needed."""

ANSWER_COLUMNS = ("query_p50_s", "query_p95_s", "query_max_s")
"""Fields of the record with a policy's answer times."""


@dataclass(frozen=True, slots=True)
class AnswerTiming:
    """Answer times of a policy. Queries without an answer are errors and do not count."""

    policy: str
    episodes: int
    """Number of episodes with answer times."""
    median_s: float
    """Median over the episodes of the episode's median (s)."""
    p95_s: float
    """Median over the episodes of the episode's 95th percentile (s)."""
    longest_s: float
    """Longest time of a query (s)."""


@dataclass(frozen=True, slots=True)
class PhaseTiming:
    """Time of one simulator's workers, summed over all rows, including errors."""

    simulator: str
    episodes: int
    workers: int
    """Number of worker processes with a row; a replaced worker counts again if its name changed."""
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
    """Wall time of the episodes outside reset, physics, render and inference (s)."""
    wait_s: float
    """Idle time of workers (s)."""
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
    """Sum times per simulator, in the order of the rows, which have the columns `simulator` and `COLUMNS`."""
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
    """Summarise answer times per policy with known times, from rows with the columns `policy` and `ANSWER_COLUMNS`."""
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
