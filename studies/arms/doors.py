"""Lift and Door with arms that the zoo has no experts of: success of the oracle and of an expert for each pair.

`ARMS=FOLDER python -m studies arms --measure doors` (default `runs/arms`) plays the experts of Door that
`studies/arms/arms.sh` trains; those of Lift are in the rows of `arms`, and the oracle's in those of `oracles`. Arms
that were played are not played again.
"""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from robogauntlet.results.statistics.rates import wilson_interval
from studies.arms.arms import EPISODE, SEEDS
from studies.merging.operators import percent
from studies.percent import folder_of
from studies.shared import play_policies, table_of
from studies.tables import episodes_of, write_episodes

ARMS = ("Kinova3", "UR5e", "IIWA", "Jaco", "XArm7")
COLUMNS = {"arm": "{arm}"} | {
    f"{task}: {who}": f"{{{task}_{who}}}" for task in ("Lift", "Door") for who in ("oracle", "expert")
}


def measure() -> list[dict[str, str]]:
    """A row for each arm; writes the episodes of Door's experts beside the rows."""
    folder = folder_of("ARMS", "arms")
    frame = pd.concat(_played(folder, arm) for arm in ARMS)
    write_episodes("doors", frame, ("policy", "task", "seed"))
    rows = rows_of(frame)
    table_of(rows, COLUMNS)
    return rows


def _played(folder: Path, arm: str) -> pd.DataFrame:
    task = f"robosuite/Door@{arm}"
    expert = {"kind": "mergevla", "options": {"checkpoint": str(folder / "doors" / task.replace("/", "__"))}}
    return play_policies(folder, f"doors {arm}", {"experts": expert}, [task], SEEDS, EPISODE)


def rows_of(doors: pd.DataFrame) -> list[dict[str, str]]:
    """Success with Wilson's intervals; `doors` has a row per episode of Door's experts, with the columns `EPISODE`."""
    oracle, lifts = (episodes_of(name, name) for name in ("oracles", "arms"))
    lifts = lifts[lifts.policy == "experts"].drop_duplicates(["task", "seed"])
    experts = pd.concat([lifts[lifts.task.str.contains("/Lift")], doors])
    return [
        {"arm": arm}
        | {
            f"{task}_{who}": _rate(episodes[episodes.task == f"robosuite/{task}@{arm}"])
            for task in ("Lift", "Door")
            for who, episodes in (("oracle", oracle), ("expert", experts))
        }
        for arm in ARMS
    ]


def _rate(episodes: pd.DataFrame) -> str:
    won = int((episodes.status == "success").sum())
    interval = wilson_interval(won, len(episodes))
    return f"{percent(won / len(episodes), interval)} of {len(episodes)}" if len(episodes) else ""
