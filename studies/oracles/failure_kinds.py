"""Agreement of the measured kind of a failure with the kind that scripted policies were made to show.

The scripts and the rules were tried out on seeds from 700,000; these seeds were looked at once.
"""

from __future__ import annotations

from collections import Counter

from robogauntlet.results.record import FailureKind
from robogauntlet.results.statistics.rates import Interval, wilson_interval
from studies.percent import few
from studies.shared import open_task, table_of
from tests.orchestrator.episodes.scripted_failures import TASKS, VIEW, play_failures

SEEDS = range(600_000, 600_010)


def measure() -> list[dict[str, object]]:
    """Play every scripted failure of the nine tasks; an episode that succeeds nevertheless is left out."""
    found: Counter[tuple[str, str, str]] = Counter()
    for task in TASKS:
        simulation = open_task(task, VIEW)
        for seed in SEEDS[: few(len(SEEDS), 1)]:
            played = play_failures(task, simulation, seed)
            found.update((task, str(kind), row.failure) for kind, row in played if row.failure is not None)
        simulation.close()
    return table(found)


def table(found: Counter[tuple[str, str, str]]) -> list[dict[str, object]]:
    """Return a row for each kind, and one for all, from the counts of (task, made, measured)."""
    rows = [_row(kind, {key: n for key, n in found.items() if key[1] == kind}) for kind in map(str, FailureKind)]
    rows.append(_row("all", dict(found)))
    columns = {"made to show": "{kind}", "tasks": "{tasks}", "episodes": "{episodes}", "agree": "{agree}"}
    table_of(rows, columns | {"share [95 %]": "{share:.1%} [{low:.1%}, {high:.1%}]", "measured otherwise": "{others}"})
    return rows


def _row(kind: str, found: dict[tuple[str, str, str], int]) -> dict[str, object]:
    episodes, agree = sum(found.values()), sum(n for (_, made, measured), n in found.items() if made == measured)
    others = Counter[str]()
    for (_, made, measured), n in found.items():
        others[measured] += n if made != measured else 0
    told = ", ".join(f"{name} {n}" for name, n in others.most_common() if n)
    ends = wilson_interval(agree, episodes) or Interval(0.0, 1.0)
    counts = [{"task": task, "made": made, "measured": measured, "n": n} for (task, made, measured), n in found.items()]
    row = {"kind": kind, "tasks": len({task for task, _, _ in found}), "episodes": episodes, "agree": agree}
    return row | {
        "share": agree / max(1, episodes),
        "low": ends.low,
        "high": ends.high,
        "others": told or "-",
        "counts": counts,
    }
