"""`eval_info.json` of `lerobot-eval`: the trials of one task (`per_episode`), or of several (`per_task`)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from robogauntlet.results.store.foreign.trials import (
    BadResults,
    Results,
    Trial,
    read_label,
    read_list,
    read_mapping,
    read_success,
    refuse_task,
    task_name,
)

SOURCE = "lerobot-eval"
KEYS = ("per_episode", "per_task")
"""Keys of which a file has one."""


def read_lerobot(content: dict[str, Any], policy: str, task: str | None = None) -> Results:
    """Read the content of an `eval_info.json`.

    A file of one task does not name it: `task` does. Its trials have seeds, by which they are paired; files of several
    tasks have none.

    Raises:
        BadResults: It is none.
    """
    if "per_task" in content:
        refuse_task(task)
        return Results(SOURCE, tuple(_of_tasks(content["per_task"], policy)), paired=False)
    if task is None:
        raise BadResults("expected --task NAME, since the file does not name its task")
    named = task_name(read_label(task, "task", "--task"))
    episodes = [
        read_mapping(episode, f"per_episode[{place}]")
        for place, episode in enumerate(read_list(content["per_episode"], "per_episode"))
    ]
    seeded = bool(episodes) and all(episode.get("seed") is not None for episode in episodes)
    key = "seed" if seeded else "episode_ix"
    trials = []
    for place, episode in enumerate(episodes):
        where = f"per_episode[{place}]"
        label = read_label(episode.get(key), "trial", where)
        trials.append(Trial(policy, named, label, read_success(episode.get("success"), where)))
    return Results(SOURCE, tuple(trials), paired=seeded)


def _of_tasks(tasks: Any, policy: str) -> Iterator[Trial]:
    names = set()
    for place, given in enumerate(read_list(tasks, "per_task")):
        where = f"per_task[{place}]"
        entry = read_mapping(given, where)
        group, number = (read_label(entry.get(key), key, where) for key in ("task_group", "task_id"))
        task = task_name(f"{group}/{number}")
        if task in names:
            raise BadResults(f"{where}: expected each task once, {task} is there twice")
        names.add(task)
        successes = read_mapping(entry.get("metrics"), f"{where}.metrics").get("successes")
        for trial, success in enumerate(read_list(successes, f"{where}.metrics.successes")):
            yield Trial(policy, task, str(trial), read_success(success, f"{where}.metrics.successes[{trial}]"))
