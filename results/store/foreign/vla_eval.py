"""`*_aggregate.json` of vla-eval (the vla-evaluation-harness): the episodes of a benchmark by task."""

from __future__ import annotations

from collections import defaultdict
from typing import Any

from robogauntlet.results.store.foreign.trials import (
    LONGEST_ERROR,
    Results,
    Trial,
    read_label,
    read_list,
    read_mapping,
    read_success,
    refuse_task,
)
from robogauntlet.suites.schema import valid_name
from robogauntlet.support.text import counted, visible

SOURCE = "vla-eval"
KEYS = ("benchmark", "tasks")
"""Keys that a file has."""


def read_vla_eval(content: dict[str, Any], policy: str, task: str | None = None) -> Results:
    """Read the content of an aggregate, which names its tasks.

    An episode with a `failure_reason` could not be played: an error here, while vla-eval's own rate counts a failure.
    Tasks of one name (LIBERO-Plus has many) are told apart by their number.

    Raises:
        BadResults: It is none.
    """
    refuse_task(task)
    simulator = valid_name(read_label(content["benchmark"], "benchmark", "the file")) or "vla-eval"
    found: list[tuple[str, str, dict[str, Any], str]] = []
    numbers: dict[str, set[str]] = defaultdict(set)
    for place, given in enumerate(read_list(content["tasks"], "tasks")):
        where = f"tasks[{place}]"
        entry = read_mapping(given, where)
        name = read_label(entry.get("task"), "task", where)
        for at, value in enumerate(read_list(entry.get("episodes"), f"{where}.episodes")):
            inside = f"{where}.episodes[{at}]"
            episode = read_mapping(value, inside)
            number = read_label(episode["task_idx"], "task_idx", inside) if "task_idx" in episode else ""
            numbers[name].add(number)
            found.append((name, number, episode, inside))
    trials = []
    for name, number, one, inside in found:
        own = f"{simulator}/{name}" + (f" ({number})" if number and len(numbers[name]) > 1 else "")
        label = read_label(one.get("episode_id"), "trial", inside)
        trials.append(Trial(policy, own, label, *_outcome(one, inside)))
    errors = sum(trial.success is None for trial in trials)
    notes = []
    if errors:
        notes.append(f"{counted(errors, 'error')} of {policy}, which vla-eval counts as failures")
    if content.get("partial") is True:
        notes.append(f"the file of {policy} says that it is partial")
    return Results(SOURCE, tuple(trials), paired=False, notes=tuple(notes))


def _outcome(episode: dict[str, Any], where: str) -> tuple[bool | None, str | None]:
    """Whether the episode was a success, or None and the error."""
    if reason := episode.get("failure_reason"):
        words = f"{reason}: {episode.get('failure_detail') or 'no detail'}"
        return None, visible(words[:LONGEST_ERROR])
    if "metrics" not in episode and "success" in episode:  # so vla-eval 0.0 wrote it
        return read_success(episode["success"], where), None
    metrics = read_mapping(episode.get("metrics"), f"{where}.metrics")
    return read_success(metrics.get("success"), f"{where}.metrics"), None
