"""How close a run came to what its simulators and policies usually cost, and where the rest of the time went."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from results.record import Status

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = (
    *("simulator", "task", "policy_digest", "axis", "severity", "status", "steps", "queries"),
    *("build_s", "load_s", "reset_s", "physics_s", "render_s", "inference_s", "wait_s", "wall_s"),
)
"""Fields of the record that are needed."""
WORLD = ["task", "axis", "severity"]
"""What decides the cost of resets, steps and frames."""
ACTOR = ["task", "policy_digest"]
"""What decides the cost of an answer."""


@dataclass(frozen=True, slots=True)
class Profile:
    """One simulator's workers, or all of them, after start-up, in seconds of worker time."""

    simulator: str | None
    """None for all."""
    episodes: int
    bound_s: float
    """Of all episodes reset + steps x step + looks x (frame + answer), each at its median cost, errors aside."""
    slower_s: float
    """What resets, steps, frames and answers took beyond that; less than 0 where means are below medians."""
    rest_s: float
    """Within episodes and in none of these: hashing, checks, records."""
    wait_s: float
    """Between episodes: leases, results, nothing left to do."""
    errors_s: float
    """In episodes that ended as errors."""
    startup_s: float
    """Importing, building and loading, and what the first answers after loading took beyond others (libraries and
    weights that are loaded when they are used); not part of what is measured."""

    @property
    def measured_s(self) -> float:
        """Worker time after start-up."""
        return self.bound_s + self.slower_s + self.rest_s + self.wait_s + self.errors_s

    @property
    def efficiency(self) -> float | None:
        """The bound over what was measured; None without an episode."""
        return self.bound_s / self.measured_s if self.measured_s > 0 else None


def profile(frame: pd.DataFrame) -> tuple[Profile, ...]:
    """The profile of each simulator, in the order of the frame, then of all if there are several.

    Unit costs are medians: of a reset, a control step and a frame over the episodes of one task and condition, of an
    answer over those of one task and policy. What is slower now and then (a busy machine, a first frame) is beyond.

    Args:
        frame: Records with `COLUMNS`.
    """
    if frame.empty:
        return ()
    rows = frame.assign(**{name: frame[name].astype(str) for name in ("simulator", "status", *WORLD[:2], ACTOR[1])})
    played = rows[rows["status"] != Status.ERROR]
    rows["bound_s"], answers_s = _bound(played)
    rows["first_s"] = (played["inference_s"] - answers_s).clip(lower=0.0).where(played["load_s"] > 0, 0.0)
    found = [_profile(str(name), own) for name, own in rows.groupby("simulator", sort=False)]
    return (*found, _profile(None, rows)) if len(found) > 1 else tuple(found)


def _bound(rows: pd.DataFrame) -> tuple[pd.Series, pd.Series]:
    """Of each episode the bound, and the part of it that is answers."""
    steps, looks = rows["steps"].clip(lower=1), rows["queries"].clip(lower=1)
    reset = rows.groupby([rows[name] for name in WORLD])["reset_s"].transform("median")
    step = (rows["physics_s"] / steps).groupby([rows[name] for name in WORLD]).transform("median")
    # A policy that does not look has no frames: its own median is zero.
    frame = (rows["render_s"] / looks).groupby([rows[name] for name in (*WORLD, ACTOR[1])]).transform("median")
    answer = (rows["inference_s"] / looks).groupby([rows[name] for name in ACTOR]).transform("median")
    answers = rows["queries"] * answer
    return reset + rows["steps"] * step + rows["queries"] * frame + answers, answers


def _profile(simulator: str | None, rows: pd.DataFrame) -> Profile:
    played = rows[rows["status"] != Status.ERROR]
    inside = played[["reset_s", "physics_s", "render_s", "inference_s"]].to_numpy(dtype=float).sum()
    first = float(played["first_s"].sum())
    bound = float(played["bound_s"].sum())
    return Profile(
        simulator,
        len(rows),
        bound_s=bound,
        slower_s=float(inside - first - bound),
        rest_s=float(played["wall_s"].sum() - inside),
        wait_s=float(rows["wait_s"].sum()),
        errors_s=float(rows.loc[rows["status"] == Status.ERROR, "wall_s"].sum()),
        startup_s=float(rows["build_s"].sum() + rows["load_s"].sum()) + first,
    )
