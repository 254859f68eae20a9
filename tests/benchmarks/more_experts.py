"""What further experts cost: merges of the first 3, 6 and 9 experts, their masks beside chance, and success.

`EXPERTS=FOLDER python -m tests.benchmarks more_experts` merges other experts of one base, in the order of their names,
and as many as there are.
"""

import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd
import yaml

from robogauntlet.policies.zoo import shipped
from robogauntlet.results.api import open_run
from robogauntlet.results.statistics.rates import wilson_interval
from tests.benchmarks.document import write_episodes
from tests.benchmarks.shared import kilobytes, run_suite, table_of

ORDER = (
    *("maniskill/PushCube-v1", "pybullet/PandaReach-v3", "robosuite/Lift"),
    *("maniskill/PullCube-v1", "pybullet/PandaPush-v3", "robosuite/Stack"),
    *("maniskill/StackCube-v1", "pybullet/PandaPickAndPlace-v3", "robosuite/Door"),
)
"""One task of each simulator after the other."""
NUMBERS = (3, 6, 9, 15, 20, 30, 50)
WAYS = {
    "ta-s": {"operator": "ta"},
    "ties-published-s": {"operator": "ties-published"},
    "tsv-s": {"operator": "tsv"},
    "wudi-s": {"operator": "wudi"},
    "signs-1": {"operator": "magnitude", "masks": "signs"},
}
"""Names and recipes of the suite `operators`."""
SEEDS = 20
EPISODE = ("policy", "task", "seed", "status")
COLUMNS = {
    "way": "{way}",
    "experts": "{experts}",
    "kB per task": "{kilobytes:,.0f}",
    "selfish rate (by chance)": "{selfish}",
    "cosine (by chance)": "{cosine}",
    "success in the first three tasks": "{first}",
    "in all of its tasks": "{success}",
}


def measure() -> list[dict[str, object]]:
    """A row for each way and number of experts; writes the episodes beside the rows."""
    from robogauntlet.policies.mergevla.options import expert_folders

    folders = expert_folders(shipped(os.environ.get("EXPERTS", "zoo:experts")))
    order = [task for task in ORDER if task in folders] or sorted(folders)
    rows, played = [], []
    for number in (number for number in NUMBERS if number <= len(order)):
        tasks = order[:number]
        with tempfile.TemporaryDirectory() as name:
            merged = {way: _merged({t: folders[t] for t in tasks}, way, Path(name) / way) for way in WAYS}
            (suite := Path(name) / "suite.yaml").write_text(yaml.safe_dump(_suite(tasks, Path(name))))
            run_suite(suite, folder := Path(name) / "run")
            played.append(open_run(folder).episodes(EPISODE).assign(experts=number))
        rows += [{"way": way, "experts": number, **found} for way, found in merged.items()]
        print(f"{number} experts", flush=True)
    frame = pd.concat(played)
    write_episodes("more_experts", frame, ("experts", "policy", "task", "seed"))
    rows = with_success(rows, frame)
    table_of(rows, COLUMNS)
    return rows


def with_success(rows: Sequence[Mapping[str, object]], frame: pd.DataFrame) -> list[dict[str, object]]:
    """Rows by way with their success, and Wilson's interval, in the tasks of the fewest experts and in all tasks.

    `frame` has a row per episode: number of experts, policy (a way), task, seed, status.
    """
    first = set(frame.loc[frame["experts"] == frame["experts"].min(), "task"])
    complete = []
    for row in rows:
        own = frame[(frame["policy"] == row["way"]) & (frame["experts"] == row["experts"])]
        complete.append({**row, "first": _rate(own[own["task"].isin(first)]), "success": _rate(own)})
    return sorted(complete, key=lambda row: list(WAYS).index(str(row["way"])))


def _rate(episodes: pd.DataFrame) -> str:
    successes, trials = int((episodes["status"] == "success").sum()), int((episodes["status"] != "error").sum())
    interval = wilson_interval(successes, trials)
    assert interval is not None
    return f"{successes / trials:.0%} [{100 * interval.low:.0f}, {100 * interval.high:.0f}]".replace("%", " %")


def _merged(folders: Mapping[str, Path], way: str, folder: Path) -> dict[str, object]:
    """Merge, save and describe."""
    from robogauntlet.policies.mergevla.checkpoints.merge_experts import merge_experts, read_experts
    from robogauntlet.policies.mergevla.checkpoints.merged_checkpoint import save_merged, tensors_of_parts
    from robogauntlet.policies.mergevla.merging.recipe import MaskRule, Recipe

    recipe = Recipe(**WAYS[way])  # type: ignore[arg-type]
    merging = merge_experts(read_experts(folders.values()), recipe)
    save_merged(folder, merging)
    report = merging.report
    cosines = [sum(found.cosine.values()) / len(folders) for found in (report.observed, report.null)]
    return {
        "kilobytes": kilobytes(tensors_of_parts(merging.parts)) / len(folders),
        "selfish": f"{report.observed.selfish:.3f} ({report.null.selfish:.3f})"
        if recipe.masks is MaskRule.TASK
        else "",
        "cosine": "{:.3f} ({:.3f})".format(*cosines),
    }


def _suite(tasks: Sequence[str], folder: Path) -> dict[str, object]:
    options = {way: {"checkpoint": str(folder / way), "router": "oracle"} for way in WAYS}
    return {
        "name": "more-experts",
        "policies": [{"name": way, "kind": "mergevla-merged", "options": options[way]} for way in WAYS],
        "tasks": list(tasks),
        "seeds": {"count": SEEDS},
        "image_size": 96,
        "render_profile": "fast-2",
    }
