"""What limits experts of Stack and StackCube: one of few demonstrations, the same asked more often, other trainings.

`STACKING=FOLDER python -m studies merging --measure stacking` (default `runs/stacking`) plays the experts of
`studies/merging/stacking.sh` beside the zoo's. What is finished in the folder is kept, so that the same command
continues.
"""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pandas as pd

from robogauntlet.results.statistics.pairs import Pairs, paired_difference
from robogauntlet.results.statistics.rates import wilson_interval
from robogauntlet_mergevla.checkpoints.metadata import METADATA_FILE, WEIGHTS
from robogauntlet_mergevla.zoo import shipped
from studies.merging.operators import percent
from studies.shared import play_policies, table_of
from studies.tables import write_episodes

FEWER, SHIPPED = "fewer", "zoo"
TASKS = {"robosuite/Stack": (700, (6, 4, 2)), "maniskill/StackCube-v1": (500, (1,))}
"""Task to the number of few demonstrations, and to numbers of steps of a chunk that the expert of few executes instead
of its own, 8 and 2."""
TITLES = {
    FEWER: "{} demonstrations",
    "longer": "half as many steps more",
    "slowly": "half the learning rate",
    SHIPPED: "2,000 demonstrations (the zoo's)",
    "corrected": "400 corrections beside the demonstrations",
    "corrected-slowly": "400 corrections, half the learning rate",
}
"""Expert to what is different about it, in the order of the table."""
SEEDS, OTHER_SEEDS = 100, 200
"""From 0 for all experts, and further ones for the zoo's, which were taken into it because of the first."""
EPISODE = ("policy", "task", "seed", "status", "failure")
COLUMNS = {"task": "{task}", "expert": "{title}", "success": "{success}", "difference to the first, points": "{apart}"}


def measure() -> list[dict[str, object]]:
    """A row for each task and expert; writes the episodes beside the rows."""
    folder = Path(os.environ.get("STACKING", "runs/stacking")).absolute()
    frames, others = [], []
    for task, (_, numbers) in TASKS.items():
        name = task.replace("/", "__")
        experts = {path.parent.name: path for path in sorted(folder.glob(f"experts/*/{name}"))}
        experts |= {f"executes-{steps}": executing(experts[FEWER], steps, folder) for steps in numbers}
        experts[SHIPPED] = shipped("zoo:experts") / name
        policies = {key: {"kind": "mergevla", "options": {"checkpoint": str(path)}} for key, path in experts.items()}
        frames.append(play_policies(folder, name, policies, [task], SEEDS, EPISODE))
        zoo = {SHIPPED: policies[SHIPPED]}
        others.append(play_policies(folder, f"{name}, other seeds", zoo, [task], OTHER_SEEDS, EPISODE, first=SEEDS))
    frame = pd.concat(frames)
    write_episodes("stacking", frame, EPISODE[:3])
    write_episodes("stacking_other_seeds", pd.concat(others), EPISODE[:3])
    rows = rows_of(frame)
    table_of(rows, COLUMNS)
    return rows


def executing(expert: Path, steps: int, folder: Path) -> Path:
    """A copy of an expert that executes this number of steps of a chunk before its next query."""
    copy = folder / "executing" / f"{expert.name}-{steps}"
    if not (copy / METADATA_FILE).exists():
        copy.mkdir(parents=True, exist_ok=True)
        shutil.copy(expert / WEIGHTS, copy)
        metadata = json.loads((expert / METADATA_FILE).read_text(encoding="utf-8"))
        changed = metadata | {"action_steps": steps, "base": "zoo:base"}
        (copy / METADATA_FILE).write_text(json.dumps(changed), encoding="utf-8")
    return copy


def rows_of(frame: pd.DataFrame) -> list[dict[str, object]]:
    """Success with Wilson's interval, and its difference to the first expert on the same episodes with Newcombe's.

    `frame` has a row per episode with the columns `EPISODE`.
    """
    won = frame.assign(won=frame.status == "success").pivot(index="seed", columns=["task", "policy"], values="won")
    rows: list[dict[str, object]] = []
    for task, (few, numbers) in TASKS.items():
        titles = TITLES | {f"executes-{steps}": f"the first, steps of a chunk executed: {steps}" for steps in numbers}
        for policy in (policy for policy in titles if (task, policy) in won):
            outcomes, fewer = (won[task, name].to_numpy(float) for name in (policy, FEWER))
            found = paired_difference(Pairs.from_outcomes(outcomes, fewer))
            assert found is not None
            assert found.interval is not None
            ends = (f"{100 * end:+.0f}" for end in (found.value, found.interval.low, found.interval.high))
            value, low, high = ends
            rows.append(
                {
                    "task": task,
                    "policy": policy,
                    "title": titles[policy].format(few),
                    "success": percent(outcomes.mean(), wilson_interval(int(outcomes.sum()), len(outcomes))),
                    "apart": "" if policy == FEWER else f"{value} [{low}, {high}]",
                }
            )
    return rows
