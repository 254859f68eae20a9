"""How often planted defects are found: `compare` and `compare --gate` on drawn seeds, beside what `plan` predicts.

`INSTRUMENT=FOLDER python -m studies instrument --measure instrument` (default `runs/instrument`) plays what the folder
lacks.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from robogauntlet import OpenRun
from robogauntlet.results.statistics.multiplicity import ALPHA
from robogauntlet.results.statistics.pairs import Pairs, paired_difference
from robogauntlet.results.statistics.sample_size import mcnemar_power, pairs_for_power
from studies.instrument.draws import (
    EPISODE,
    REFERENCE,
    SEEDS,
    answers,
    builds,
    drawn_rows,
    episodes_of_builds,
    renamed,
    rows_of_run,
)
from studies.shared import table_of
from studies.tables import episodes_of, write_episodes

TASKS = {
    "maniskill/PushCube-v1": "ManiSkill",
    "pybullet/PandaPickAndPlace-v3": "PyBullet",
    "robosuite/Lift": "robosuite",
}
DEFECTS = {
    "bits-4": "4 bits",
    "bits-3": "3 bits",
    "bits-2": "2 bits",
    "noise-06": "noise of 6 %",
    "noise-12": "noise of 12 %",
    "noise-20": "noise of 20 %",
    "delay-1": "a step late",
    "delay-2": "two steps late",
    "flipped": "gripper flipped in a tenth",
    "mirrored": "camera mirrored",
}
"""Build to its defect, the grades of one kind in their order."""
COLUMNS = {
    "defect": "{defect}",
    f"success (%): {', '.join(TASKS.values())}": "{success}",
    "loss": "{loss}",
    "seeds by `plan`": "{planned}",
    "found with these": "{at_planned}",
    f"`compare` finds (`plan` predicts), {', '.join(map(str, SEEDS))} seeds": "{compare}",
    "`compare --gate` finds": "{gate}",
}


def measure() -> list[dict[str, Any]]:
    """A row for each defect; writes the episodes beside the rows."""
    played = builds()
    frame = episodes_of_builds(played)
    write_episodes("instrument", frame, EPISODE[:3])
    before = rows_of_run(played[REFERENCE])
    found = []
    for build in DEFECTS:
        found.append({"build": build} | _detected(played[build], played[REFERENCE], before, pairs_of(frame, build)))
        print(found[-1], flush=True)
    table_of(_rows(found, frame), COLUMNS)
    return found


def counted(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows with success, differences and predictions counted in the kept episodes."""
    return _rows(rows, episodes_of("instrument", "instrument"))


def pairs_of(frame: pd.DataFrame, build: str) -> Pairs:
    """A build and the reference on the same seeds."""
    one, other = (
        (own.set_index(["task", "seed"])["status"] == "success").sort_index().to_numpy(float)
        for own in (frame[frame["build"] == name] for name in (build, REFERENCE))
    )
    return Pairs.from_outcomes(one, other)


def planned_seeds(pairs: Pairs) -> int | None:
    """The seeds of each task that `plan --detect` names for the difference and the disagreement of these pairs."""
    lost, disagree = (pairs.second - pairs.first) / pairs.trials, _disagree(pairs)
    return pairs_for_power(disagree, lost, ALPHA, step=len(TASKS)) // len(TASKS) if lost > 0 else None


def _disagree(pairs: Pairs) -> float:
    return (pairs.first_only + pairs.second_only) / pairs.trials


def _detected(run: OpenRun, reference: OpenRun, before: pd.DataFrame, pairs: Pairs) -> dict[str, Any]:
    """Shares of the drawn comparisons in which each verb finds the defect, by seeds."""
    rows = rows_of_run(run)
    shares: dict[str, dict[int, float]] = {"compare": {}, "gate": {}}
    for count in dict.fromkeys([*SEEDS, planned_seeds(pairs) or SEEDS[0]]):
        drawn = ([renamed(own.iloc[places]) for own in (rows, before)] for places in drawn_rows(rows, count))
        found = [answers(run, reference, *sides) for sides in drawn]
        for verb, share in shares.items():
            share[count] = float(np.mean([getattr(answer, verb) for answer in found]))
    return shares


def _rows(found: Sequence[dict[str, Any]], frame: pd.DataFrame) -> list[dict[str, Any]]:
    return [_row(one, frame) for one in found]


def _row(found: dict[str, Any], frame: pd.DataFrame) -> dict[str, Any]:
    pairs, own = pairs_of(frame, found["build"]), frame[frame["build"] == found["build"]]
    shares = {verb: {int(count): share for count, share in found[verb].items()} for verb in ("compare", "gate")}
    planned, estimate = planned_seeds(pairs), paired_difference(pairs)
    assert estimate is not None
    assert estimate.interval is not None
    low, high = (-100 * end for end in (estimate.interval.high, estimate.interval.low))
    of_tasks = (own[own["task"] == task]["status"] for task in TASKS)
    return {
        "defect": DEFECTS[found["build"]],
        "success": ", ".join(f"{100 * (of_task == 'success').mean():.0f}" for of_task in of_tasks),
        "loss": f"{-100 * estimate.value + 0:.1f} [{low:.1f}, {high:.1f}]",
        "planned": planned or "-",
        "at_planned": f"{100 * shares['compare'][planned]:.0f} %" if planned else "-",
        "compare": ", ".join(f"{100 * shares['compare'][count]:.0f}{predicted(pairs, count)}" for count in SEEDS),
        "gate": ", ".join(f"{100 * shares['gate'][count]:.0f}" for count in SEEDS),
    }


def predicted(pairs: Pairs, seeds: int) -> str:
    """The power of McNemar's test over all tasks, in percent, if these pairs show the true rates."""
    lost = (pairs.second - pairs.first) / pairs.trials
    return f" ({100 * mcnemar_power(seeds * len(TASKS), _disagree(pairs), lost, ALPHA):.0f})" if lost > 0 else ""
