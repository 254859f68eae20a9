"""A run of rows from results of others: its document states what is known, its rows success or failure and no more."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from robogauntlet.results.record import EpisodeResult, Status, outcome_row, rows_hash
from robogauntlet.results.run_document import MAX_COUNT, RESULTS_OF_OTHERS, PlannedCell, RunDocument, RunStatus
from robogauntlet.results.store.exported_run import BATCH, arriving_run, store_rows
from robogauntlet.results.store.foreign.trials import BadResults, Results, Trial
from robogauntlet.suites.episode import CLEAN, Cell, content_hash
from robogauntlet.suites.ranges import MAX_ENTRIES, MAX_NAME
from robogauntlet.suites.schema import Suite, valid_name
from robogauntlet.support.text import visible

HORIZON = 1
"""Stands for the unknown number of control steps, so that no episode that was played here has a pair among the rows."""
HASH_DIGITS = 12
"""Hexadecimal digits of a label's hash that stand for its seed: less than `MAX_COUNT`."""


def import_results(
    results: Results,
    files: Sequence[Path],
    root: Path,
    *,
    suite: str,
    name: str | None = None,
    check: Callable[[RunDocument], None] | None = None,
) -> tuple[Path, RunDocument]:
    """Create a run folder from results of others; return it and the document, whose origin is `imported`.

    Args:
        results: What the files hold.
        files: The files, for the document.
        root: Parent of the new folder.
        suite: Name of the suite that the run is listed under.
        name: Name of the new folder; None for the suite's name and the start of the run's id.
        check: Called with the document before the folder is created; raises RunError to refuse it.

    Raises:
        BadResults: They cannot be a run: a trial is there twice, or names are alike or too many.
        RunError: The folder exists.
        StoreError: The rows cannot be written.
        OSError: The folder cannot be written.
    """
    rows = list(_rows(results, _policies(results.trials), suite))
    document = _document(results, files, suite, rows)
    with arriving_run(root, document, name, check) as (run, folder):
        store_rows(run, document, (rows[at : at + BATCH] for at in range(0, len(rows), BATCH)))
    return folder, document


def _policies(trials: Sequence[Trial]) -> dict[str, str]:
    """Policy to its name in the run. Raises BadResults."""
    names: dict[str, str] = {}
    for given in dict.fromkeys(trial.policy for trial in trials):
        name = valid_name(given)
        if not name:
            raise BadResults(f"expected a policy with a letter or digit in its name, got '{given}'")
        if name in names.values():
            other = next(one for one, made in names.items() if made == name)
            raise BadResults(f"expected policies with different names, got '{other}' and '{given}': both are {name}")
        names[given] = name
    return names


def _rows(results: Results, names: dict[str, str], suite: str) -> Iterator[EpisodeResult]:
    """The rows. Raises BadResults for a trial that is there twice."""
    outcomes: dict[tuple[str, str, str], bool | None] = {}
    for trial in results.trials:
        key = (trial.policy, trial.task, trial.label)
        if key in outcomes:
            how = "twice" if outcomes[key] == trial.success else "twice, with different outcomes"
            shown = f"trial {trial.label} of {trial.policy} in {trial.task}"
            raise BadResults(f"expected each trial once, {shown} is there {how}")
        outcomes[key] = trial.success
    own: dict[str, list[list[object]]] = {given: [] for given in names}
    for (policy, task, label), success in sorted(outcomes.items(), key=lambda item: item[0]):
        own[policy].append([task, label, success])
    protocol = Suite.model_validate(_suite("x", ["x"], ["x/x"], 1)).protocol_with(HORIZON)
    # Nothing is known of a policy's content: that of another import is another one.
    digests = {given: content_hash([suite, names[given], rows]) for given, rows in own.items()}
    for trial in results.trials:
        cell = Cell(names[trial.policy], digests[trial.policy], trial.task, protocol)
        episode = cell.episode(_seed(trial.label) if results.paired else _seed(f"{cell.policy_digest} {trial.label}"))
        if trial.success is None:
            yield EpisodeResult.failed_to_run(episode, trial.error or "error")
            continue
        yield EpisodeResult.from_episode(
            episode,
            status=str(Status.SUCCESS if trial.success else Status.FAILURE),
            success_once=trial.success,
            steps=0,
            queries=0,
            clipped_steps=0,
            reward_sum=0.0,
            state_hash=content_hash(["stated", trial.task, trial.label]) if results.paired else "",
            final_state_hash="",
            actions_hash="",
        )


def _seed(label: str) -> int:
    if label.isdecimal() and label.isascii() and int(label) <= MAX_COUNT:
        return int(label)
    return int(content_hash(label, length=HASH_DIGITS), 16)


def _document(results: Results, files: Sequence[Path], suite: str, rows: Sequence[EpisodeResult]) -> RunDocument:
    """What is known of the run. Raises BadResults for more policies or tasks than a suite has."""
    counts: dict[tuple[str, str, str], int] = {}
    for row in rows:
        cell = (row.policy, row.policy_digest, row.task)
        counts[cell] = counts.get(cell, 0) + 1
    policies, tasks = (list(dict.fromkeys(cell[part] for cell in counts)) for part in (0, 2))
    for what, names in (("policies", policies), ("tasks", tasks)):
        if len(names) > MAX_ENTRIES:
            raise BadResults(f"expected at most {MAX_ENTRIES:,} {what}, got {len(names):,}")
    plan = [
        PlannedCell(
            simulator=task.partition("/")[0],
            task=task,
            policy=policy,
            policy_digest=digest,
            axis=CLEAN,
            severity=0,
            planned=count,
        )
        for (policy, digest, task), count in counts.items()
    ]
    found, now = rows_hash(map(outcome_row, rows)), time.time()
    return RunDocument(
        run_id=content_hash([suite, found], length=32),
        suite=Suite.model_validate(_suite(suite, policies, tasks, max(counts.values()))),
        suite_hash=content_hash([[cell.policy_digest, cell.task] for cell in plan]),
        suite_text=f"# rows from {results.source}; there is nothing to play\n",
        suite_path=visible(", ".join(map(str, files)))[:4096],
        origin="imported",
        started_at=now,
        finished_at=now,
        status=RunStatus.COMPLETE,
        plan=tuple(plan),
        warnings=tuple(_warnings(results)),
        rows_hash=found,
    )


def _suite(name: str, policies: Sequence[str], tasks: Sequence[str], count: int) -> dict[str, object]:
    return {
        "name": name[:MAX_NAME],
        "description": "Results of others, as rows.",
        "policies": [{"name": policy, "kind": RESULTS_OF_OTHERS} for policy in policies],
        "tasks": list(tasks),
        "seeds": {"count": count},
        "horizon": HORIZON,
    }


def _warnings(results: Results) -> Iterator[str]:
    yield (
        f"The rows are from {results.source} of others: success is what it says; how it was counted, and the horizon, "
        "images and versions, are not known"
    )
    if results.paired:
        yield "It is the word of others that trials of one task and number start from the same state"
    else:
        yield "Start states are not known: policies are compared as separate trials, not in pairs"
