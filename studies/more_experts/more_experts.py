"""What further experts cost: merges of 3 to 20 experts of Meta-World on a base that has not seen it.

`META_WORLD=FOLDER python -m studies more_experts --measure more_experts` (default `runs/meta-world`) merges and plays
the experts of `studies/more_experts/meta_world.sh`. What is finished in the folder is kept, so that the same command
continues.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from robogauntlet.results.statistics.pairs import Pairs, paired_difference
from robogauntlet.results.statistics.rates import wilson_interval
from robogauntlet_mergevla.options import expert_folders
from studies.merging.operators import kept_of, percent
from studies.percent import folder_of
from studies.shared import FITTED_ROUTERS, kilobytes, merged_policy, play_policies, table_of
from studies.tables import episodes_of, write_episodes

if TYPE_CHECKING:
    from robogauntlet_mergevla.checkpoints.merge_experts import Merging

NUMBERS = (3, 6, 9, 15, 20)
EXPERTS, UNMERGED, ROUTED = "experts", "none-4", "magnitude-2-blind"
WAYS: dict[str, dict[str, Any]] = {
    UNMERGED: {"operator": "none", "masks": "none", "options": {"bits": 4}},
    "magnitude-2": {"operator": "magnitude", "masks": "signs", "rounds": 2},
    "ta-s": {"operator": "ta"},
    "ties-s": {"operator": "ties"},
    "ties-published-s": {"operator": "ties-published"},
    "tsv-s": {"operator": "tsv"},
    "wudi-s": {"operator": "wudi"},
    "ta-s-averaged-trunk": {"operator": "ta", "trunk": "mean"},
}
"""Names and recipes of the suite `operators`."""
TITLES = {
    EXPERTS: "experts",
    UNMERGED: "four bits each, not merged",
    "magnitude-2": "two bits of magnitudes",
    ROUTED: "the same, routed without the instruction",
    "ta-s": "TA+S",
    "ties-s": "TIES+S",
    "ties-published-s": "TIES+S as published",
    "tsv-s": "TSV+S",
    "wudi-s": "WUDI+S",
    "ta-s-averaged-trunk": "TA+S, averaged trunk",
}
DESCRIBED = ("kilobytes", "keep", "selfish", "cosine")
"""What is known of a merge before it is played."""
SEEDS = 10
EPISODE = ("policy", "task", "seed", "status", "inferred_task")
COLUMNS = {
    "way": "{title}",
    "experts": "{experts}",
    "kB per task": "{kilobytes}",
    "keep rate (by chance)": "{keep}",
    "selfish rate (by chance)": "{selfish}",
    "cosine (by chance)": "{cosine}",
    "success": "{success}",
    "of the experts'": "{kept}",
    "in the tasks of the row above (points)": "{change}",
}


def measure() -> list[dict[str, object]]:
    """A row for each way and number of experts; writes the episodes beside the rows."""
    folder = folder_of_experts()
    tasks = in_order(expert_folders(folder / "experts"))
    apart = {EXPERTS: {"kind": "mergevla-experts", "options": {"folder": str(folder / "experts")}}}
    frames, described = [], dict[tuple[str, int], dict[str, str]]()
    for number in (number for number in NUMBERS if number <= len(tasks)):
        last = number == min(NUMBERS[-1], len(tasks))  # what is not merged does not depend on the number
        ways = [way for way in WAYS if last or way != UNMERGED]
        described |= {(way, number): merged(folder, tasks[:number], way, WAYS[way]) for way in ways}
        policies = {way: merged_policy(folder_of_merge(folder, number, way)) for way in ways}
        routed = folder_of_merge(folder, number, "magnitude-2")
        policies |= {ROUTED: merged_policy(routed, "calibrated", sees_instruction=False)} | (apart if last else {})
        played = play_policies(folder, str(number), policies, tasks[:number], SEEDS, EPISODE)
        frames.append(played.assign(experts=number))
    frame = pd.concat(frames)
    write_episodes("more_experts", frame, ("experts", "policy", "task", "seed"))
    rows = rows_of(frame, [{"policy": way, "experts": number, **what} for (way, number), what in described.items()])
    table_of(rows, COLUMNS)
    return rows


def counted(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, object]]:
    """The rows again, from the kept episodes."""
    return rows_of(episodes_of("more_experts", "more_experts"), rows)


def rows_of(frame: pd.DataFrame, described: Sequence[Mapping[str, object]]) -> list[dict[str, object]]:
    """Success with Wilson's interval, its share of the experts', and its change by the experts that were added.

    Args:
        frame: A row per episode: number of experts, policy, task, seed, status.
        described: Rows with policy, number of experts, and `DESCRIBED`.
    """
    won = frame.assign(won=frame.status.map({"success": 1.0, "failure": 0.0})).pivot(
        index=["task", "seed"], columns=["policy", "experts"], values="won"
    )
    known = {(row["policy"], row["experts"]): {key: row[key] for key in DESCRIBED} for row in described}
    rows = []
    for policy in TITLES:
        before: pd.Series | None = None
        for number in sorted(won[policy].columns):
            outcomes = won[policy, number].dropna()
            experts = won[EXPERTS].iloc[:, 0].loc[outcomes.index]
            interval = wilson_interval(int(outcomes.sum()), len(outcomes))
            assert interval is not None
            rows.append(
                {
                    "policy": policy,
                    "experts": number,
                    "title": TITLES[policy],
                    **known.get((policy, number), dict.fromkeys(DESCRIBED, "")),
                    "success": percent(outcomes.mean(), interval),
                    "kept": "" if policy == EXPERTS else kept_of(outcomes.to_numpy(), experts.to_numpy()),
                    "change": "" if before is None else _change(outcomes.loc[before.index], before),
                }
            )
            before = outcomes
    return rows


def _change(after: pd.Series, before: pd.Series) -> str:
    found = paired_difference(Pairs.from_outcomes(after.to_numpy(), before.to_numpy()))
    assert found is not None
    assert found.interval is not None
    value, low, high = (
        f"{round(100 * part) + 0:+d}" for part in (found.value, found.interval.low, found.interval.high)
    )
    return f"{value} [{low}, {high}]"


def folder_of_experts() -> Path:
    """The folder of `studies/more_experts/meta_world.sh`."""
    return folder_of("META_WORLD", "meta-world")


def in_order(tasks: Mapping[str, object]) -> list[str]:
    """All tasks in a random order, the same for each call, since neighbours in the alphabet are alike."""
    names = sorted(tasks)
    return [names[place] for place in np.random.default_rng(0).permutation(len(names))]


def merged(folder: Path, tasks: Sequence[str], way: str, recipe: Mapping[str, Any]) -> dict[str, str]:
    """Merge the experts of these tasks by a recipe, unless that is done, and describe the merge."""
    from robogauntlet.policies.training.dataset import datasets_of
    from robogauntlet_mergevla.checkpoints.merge_experts import merge_experts, read_experts
    from robogauntlet_mergevla.checkpoints.merged_checkpoint import save_merged
    from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
    from robogauntlet_mergevla.merging.recipe import Recipe
    from robogauntlet_mergevla.routing.catalog import fit_routers
    from robogauntlet_mergevla.routing.demonstrations import first_observations

    out = folder_of_merge(folder, len(tasks), way)
    description = out / "described.json"
    if not description.exists():
        folders = expert_folders(folder / "experts")
        merging = merge_experts(read_experts(folders[task] for task in tasks), Recipe(**recipe))
        fitted = {}
        if way == "magnitude-2":
            model = MergedModel(merging.parts)
            shown = [folder / "demonstrations" / task.replace("/", "__") for task in tasks]
            first = first_observations(datasets_of(shown, model.experts), model.architecture.cameras)
            fitted = fit_routers(model, first.frames, first.held_out, FITTED_ROUTERS)
        save_merged(out, merging, fitted)
        description.write_text(json.dumps(_described(merging)))
    found: dict[str, str] = json.loads(description.read_text())
    return found


def folder_of_merge(folder: Path, number: int, way: str) -> Path:
    """Where the checkpoint of a merge lies."""
    return folder / "merges" / str(number) / way


def _described(merging: Merging) -> dict[str, str]:
    from robogauntlet_mergevla.checkpoints.merged_checkpoint import tensors_of_parts

    def both(text: str, *values: float) -> str:
        return f"{{:{text}}} ({{:{text}}})".format(*values)

    sides = merging.report.observed, merging.report.null
    masked = merging.parts.merged.masks and merging.parts.recipe.masks.value == "task"
    is_merged = merging.parts.recipe.operator != "none"
    return {
        "kilobytes": f"{kilobytes(tensors_of_parts(merging.parts)) / len(merging.parts.tasks):,.0f}",
        "keep": both(".3f", *(fmean(side.keep.values()) for side in sides)) if masked else "",
        "selfish": both(".3f", *(side.selfish for side in sides)) if masked else "",
        "cosine": both(".3f", *(fmean(side.cosine.values()) for side in sides)) if is_merged else "",
    }
