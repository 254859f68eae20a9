"""Merging experts of several arms: one skill on four arms, three skills on three arms, and arms that no expert has.

`ARMS=FOLDER python -m studies arms --measure arms` (default `runs/arms`) merges and plays the experts of
`studies/arms/arms.sh` and two of the zoo. What is finished in the folder is kept, so that the same command continues.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from robogauntlet.results.statistics.rates import wilson_interval
from robogauntlet_mergevla.options import expert_folders
from robogauntlet_mergevla.zoo import shipped
from studies.merging.operators import kept_of, percent
from studies.percent import folder_of
from studies.shared import FITTED_ROUTERS, merged_policy, play_policies, run_gauntlet, table_of
from studies.tables import write_episodes

ONE_SKILL = ("robosuite/Lift", "robosuite/Lift@UR5e", "robosuite/Lift@Kinova3", "robosuite/Lift@IIWA")
THREE_SKILLS = ("robosuite/Stack", "robosuite/Lift@UR5e", "robosuite/Door@Kinova3")
UNSEEN = ("robosuite/Lift@Jaco", "robosuite/Lift@XArm7")
"""Experts of these arms are played, and take part in no merge."""
SETTINGS = {"one skill": ONE_SKILL, "three skills": THREE_SKILLS, "unseen arms": UNSEEN}
MERGES = {
    "none-4": ("four bits each, not merged", ["--operator", "none", "--bits", "4"]),
    "magnitude-2": ("two bits of magnitudes", ["--operator", "magnitude", "--rounds", "2"]),
    "ties-s": ("TIES+S, trunk by vectors", ["--operator", "ties"]),
    "ta-s": ("TA+S, trunk by vectors", ["--operator", "ta"]),
    "ties-s-averaged-trunk": ("TIES+S, averaged trunk", ["--operator", "ties", "--trunk", "mean"]),
    "ta-s-averaged-trunk": ("TA+S, averaged trunk", ["--operator", "ta", "--trunk", "mean"]),
    "naive-mean": (
        "mean of everything",
        [*("--operator", "mean", "--masks", "none"), *("--trunk", "mean", "--keep-blocks", "0", "--merge-output")],
    ),
}
"""Name to title and options of `robogauntlet mergevla merge`."""
ROUTED = {
    "magnitude-2-calibrated": ("magnitude-2", "calibrated"),
    "magnitude-2-self-trained": ("magnitude-2", "self-trained"),
    "ta-s-averaged-trunk-paper-coded": ("ta-s-averaged-trunk", "paper-coded"),
}
"""Name to merge and router."""
SEEDS = 50
EPISODE = ("policy", "task", "seed", "status", "inferred_task", "failure")
COLUMNS = {
    "setting": "{setting}",
    "policy": "{title}",
    "success by task (%)": "{tasks}",
    "all": "{success}",
    "of the experts'": "{kept}",
    "experts chosen": "{chosen}",
}


def measure() -> list[dict[str, object]]:
    """A row for each setting and policy; writes the episodes beside the rows."""
    folder = folder_of("ARMS", "arms")
    experts = {**expert_folders(shipped("zoo:experts")), **expert_folders(folder / "experts")}
    each = _play(folder, "each", {f"expert-of-{_arm(t)}": _expert(experts[t]) for t in ONE_SKILL}, ONE_SKILL + UNSEEN)
    alone = [
        _play(folder, t.rpartition("/")[2], {"experts": _expert(experts[t])}, [t]) for t in (*THREE_SKILLS, *UNSEEN)
    ]
    own = pd.concat([each[each.policy == "expert-of-" + each.task.map(_arm)].assign(policy="experts"), *alone])
    frames = [each.assign(setting="one skill")]
    for setting, tasks, others in (("one skill", ONE_SKILL, UNSEEN), ("three skills", THREE_SKILLS, ())):
        merges = merges_of(folder, setting.replace(" ", "-"), {task: experts[task] for task in tasks})
        told = {way: merged_policy(out) for way, out in merges.items()}
        routed = {name: merged_policy(merges[way], router) for name, (way, router) in ROUTED.items()}
        played = [
            own[own.task.isin([*tasks, *others])].drop_duplicates(["task", "seed"]),
            _play(folder, f"{setting} told", told, tasks),
            _play(folder, f"{setting} routed", routed, (*tasks, *others)),
        ]
        frames += [episodes.assign(setting=setting) for episodes in played]
    frame = pd.concat(frames)
    frame.loc[frame.task.isin(UNSEEN), "setting"] = "unseen arms"
    write_episodes("arms", frame, ("setting", "policy", "task", "seed"))
    rows = rows_of(frame)
    table_of(rows, COLUMNS)
    return rows


def rows_of(frame: pd.DataFrame, settings: Mapping[str, Sequence[str]] = SETTINGS) -> list[dict[str, object]]:
    """Success by task and in all with Wilson's interval, its share of the experts' paired by seed, and routing.

    `frame` has a row per episode: setting, and the columns `EPISODE`; `settings` names the tasks of each.
    """
    rows: list[dict[str, object]] = []
    for setting, tasks in settings.items():
        inside = frame[frame.setting == setting]
        won = inside.assign(won=inside.status.map({"success": 1.0, "failure": 0.0})).pivot(
            index=["task", "seed"], columns="policy", values="won"
        )
        for policy in _order(won.columns):
            own = inside[inside.policy == policy]
            outcomes = won[policy]
            interval = wilson_interval(int(outcomes.sum()), int(outcomes.count()))
            assert interval is not None
            rows.append(
                {
                    "setting": setting,
                    "policy": policy,
                    "title": _title(policy),
                    "tasks": " / ".join(f"{100 * outcomes[t].mean():.0f}" for t in tasks),
                    "success": percent(outcomes.mean(), interval),
                    "kept": "" if policy == "experts" else kept_of(*won[[policy, "experts"]].to_numpy().T),
                    "chosen": _chosen(own, setting) if policy in ROUTED else "",
                }
            )
    return rows


def merges_of(folder: Path, setting: str, experts: Mapping[str, Path], ways: Iterable[str] = MERGES) -> dict[str, Path]:
    """Merge the experts in these ways, unless that is done: names to checkpoints."""
    merges = {way: folder / "merges" / setting / way for way in ways}
    shown = [folder / "demonstrations" / task.replace("/", "__") for task in experts]
    for way, out in merges.items():
        if not out.exists():
            datasets = [word for dataset in shown for word in ("--demonstrations", dataset)]
            datasets += [word for name in FITTED_ROUTERS for word in ("--router", name)] if shown else []
            run_gauntlet("mergevla", "merge", *experts.values(), "--out", out, *MERGES[way][1], *datasets)
    return merges


def _order(policies: Sequence[str]) -> list[str]:
    known = ["experts", *(f"expert-of-{_arm(task)}" for task in ONE_SKILL), *MERGES, *ROUTED]
    return sorted(policies, key=known.index)


def _title(policy: str) -> str:
    if policy in ROUTED:
        way, router = ROUTED[policy]
        return f"{MERGES[way][0]}, routed: {router}"
    return f"{MERGES[policy][0]}, oracle-routed" if policy in MERGES else policy.replace("-", " ")


def _chosen(episodes: pd.DataFrame, setting: str) -> str:
    """The share of episodes that were routed to their task's expert, or of each arm's expert on the unseen arms."""
    if setting != "unseen arms":
        right = episodes.inferred_task == episodes.task
        interval = wilson_interval(int(right.sum()), len(right))
        return f"right in {percent(right.mean(), interval)}"
    found = episodes.inferred_task.map(_arm).value_counts(normalize=True)
    return ", ".join(f"{arm} {100 * share:.0f} %" for arm, share in found.items())


def _arm(task: str) -> str:
    return task.partition("@")[2] or "Panda"


def _expert(folder: Path) -> dict[str, Any]:
    return {"kind": "mergevla", "options": {"checkpoint": str(folder)}}


def _play(folder: Path, name: str, policies: Mapping[str, Mapping[str, Any]], tasks: Sequence[str]) -> pd.DataFrame:
    return play_policies(folder, name, policies, tasks, SEEDS, EPISODE)
