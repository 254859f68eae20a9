"""`robogauntlet export`: write a run, its rows or its episodes, or send its results to a tracker."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import ExitStack, closing
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from robogauntlet.orchestrator.cli.common import OwnSuite, RunArgument, StoreUrl, out, print_line, refuse
from robogauntlet.orchestrator.cli.new.demonstrations import conclude_recording
from robogauntlet.orchestrator.replay.dataset_export import DatasetExport, write_datasets
from robogauntlet.orchestrator.replay.episode_filter import EpisodeFilter
from robogauntlet.orchestrator.replay.replay import environments_of, policy_sources
from robogauntlet.orchestrator.runs.playable_suite import playable_suite
from robogauntlet.orchestrator.runs.progress_display import RecordingProgress
from robogauntlet.orchestrator.trackers import PROJECT, TrackerName, open_tracker
from robogauntlet.results.api import OpenRun, open_run
from robogauntlet.results.report import export_formats
from robogauntlet.results.report.formatting import counted, spreadsheet_cell
from robogauntlet.results.run_document import RunDocument, read_run
from robogauntlet.results.store.arriving import arriving_file
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.episodes_parquet import write_parquet
from robogauntlet.results.store.exported_run import ARCHIVE, export_run
from robogauntlet.support.errors import BadInput


class Format(StrEnum):
    """Format of an exported run."""

    RUN = "run"
    """The whole run, for `robogauntlet import`."""
    CSV = "csv"
    PARQUET = "parquet"
    LEROBOT = "lerobot"
    """LeRobot's eval_info.json."""
    VLA_EVAL = "vla-eval"
    """The result file of vla-evaluation-harness."""
    LEROBOT_DATASET = "lerobot-dataset"
    """Replayed episodes, recorded as LeRobot v3 datasets, one per task."""


class Outcome(StrEnum):
    """How an episode ended."""

    FAILURE = "failure"
    SUCCESS = "success"


SUFFIXES = {
    Format.RUN: ARCHIVE,
    Format.CSV: ".csv",
    Format.PARQUET: ".parquet",
    Format.LEROBOT: "-eval_info.json",
    Format.VLA_EVAL: "-vla_eval.json",
    Format.LEROBOT_DATASET: "-lerobot",
}


def export(
    run: RunArgument,
    form: Annotated[
        Format, typer.Option("--format", help="The whole run, its rows as a table, or a format of another program.")
    ] = Format.RUN,
    policy: Annotated[
        str | None,
        typer.Option(help="lerobot, vla-eval, lerobot-dataset: only this policy; lerobot-dataset: or a pattern."),
    ] = None,
    task: Annotated[
        list[str] | None, typer.Option(help="lerobot-dataset: only this task, or a pattern. Repeatable.")
    ] = None,
    condition: Annotated[
        list[str] | None,
        typer.Option(help="lerobot-dataset: only this condition, such as clean, noise@4 or noise. Repeatable."),
    ] = None,
    status: Annotated[
        list[Outcome] | None,
        typer.Option(help="lerobot-dataset: episodes with this outcome; by default failures. Repeatable."),
    ] = None,
    limit: Annotated[
        int | None, typer.Option(min=1, help="lerobot-dataset: largest number of episodes per task.")
    ] = None,
    file: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="File to write, or folder of datasets; by default named after the run. A whole run is an archive if "
            f"the name ends in {ARCHIVE}, else a folder.",
        ),
    ] = None,
    media: Annotated[bool, typer.Option("--media", help="run: with its videos and pictures.")] = False,
    tracker: Annotated[
        TrackerName | None,
        typer.Option(help="Send the results to this experiment tracker instead; what was sent before is updated."),
    ] = None,
    project: Annotated[
        str | None, typer.Option(help=f"With --tracker: project of W&B, experiment of MLflow ({PROJECT}).")
    ] = None,
    store: StoreUrl = None,
    suite: OwnSuite = None,
) -> None:
    """Write a run as a file, table or datasets, or send it to a tracker.

    With --format lerobot-dataset, episodes are replayed and recorded frame by frame, for retraining.
    """
    if tracker is not None:
        given = {"--policy": policy, "--task": task, "--condition": condition, "--status": status, "--limit": limit}
        refuse("--tracker", given | {"--out": file, "--media": media, "--suite": suite})
        opened = open_run(run, store)
        address = open_tracker(tracker, project or PROJECT).send(opened.document, opened.tables(), run.absolute().name)
        print_line(f"logged: {address}")
        return
    if project is not None:
        raise BadInput("--project: expected with --tracker")
    file = file or Path(f"{run.absolute().name}{SUFFIXES[form]}")
    if form is Format.LEROBOT_DATASET:
        statuses = tuple(map(str, status or (Outcome.FAILURE,)))
        policies = () if policy is None else (policy,)
        selected = EpisodeFilter(policies, tuple(task or ()), tuple(condition or ()), statuses, limit=limit)
        _write_datasets(run, selected, file, store, suite)
        return
    if task or condition or status or limit:
        raise BadInput("expected --task, --condition, --status and --limit with --format lerobot-dataset only")
    if policy is not None and form not in (Format.LEROBOT, Format.VLA_EVAL):
        raise BadInput(f"expected --policy with --format lerobot, vla-eval or lerobot-dataset only, got {form}")
    if media and form is not Format.RUN:
        raise BadInput(f"expected --media with --format run only, got {form}")
    if form is not Format.RUN:
        _check_new(file)
    try:
        document = read_run(run)
        with closing(Store.open_begun(run, document, store)) as rows:
            if form is Format.RUN:
                count = export_run(run, document, rows, file, media=media)
            else:
                with arriving_file(file) as partial:
                    count = _write(form, document, OpenRun(run, document, store), rows, partial, policy)
    except OSError as error:
        raise BadInput(f"{file}: cannot be written: {error.strerror or error}") from None
    print_line(f"{counted(count, 'episode')} into {file}")


def _write(form: Format, document: RunDocument, run: OpenRun, rows: Store, file: Path, policy: str | None) -> int:
    if form is Format.PARQUET:
        return write_parquet(file, document, rows)
    if form is Format.CSV:
        table = run.episodes()
        texts = table.select_dtypes(exclude=["number", "bool"])
        table.assign(**{name: texts[name].map(spreadsheet_cell) for name in texts}).to_csv(file, index=False)
        return len(table)
    frame = export_formats.of_policy(run.episodes(export_formats.COLUMNS), policy)
    plain = {Format.LEROBOT: export_formats.lerobot, Format.VLA_EVAL: export_formats.vla_eval}[form](document, frame)
    file.write_text(json.dumps(plain, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return len(frame)


def _check_new(file: Path) -> None:
    """Refuse a file that exists, or a place for one that does not."""
    if file.exists() or file.is_symlink():
        raise BadInput(f"{file}: expected a new file, this one exists")
    if not file.parent.is_dir():
        raise BadInput(f"{file}: expected a file in an existing folder")


def _write_datasets(run: Path, selected: EpisodeFilter, folder: Path, store: str | None, suite: str | None) -> None:
    def listener(written: DatasetExport, count: int) -> Callable[[], None]:
        if written.existing:
            out.print(f"continuing: {written.existing} of {counted(written.wanted, 'episode')} are recorded already")
        return progress.enter_context(RecordingProgress(out, count, activity="replaying")).advance

    document = read_run(run)
    played = playable_suite(document, run, suite)
    with closing(Store.open_begun(run, document, store)) as rows:
        chosen = selected.select(document, rows.results())
    if not chosen:
        raise BadInput(f"{run}: no episode matches the options")
    with ExitStack() as progress:
        sources = policy_sources(document, played)
        written = write_datasets(chosen, document, sources, folder, listener, environments_of(played))
    for writer in written.writers.values():
        print_line(f"{writer.folder}: {counted(writer.episodes, 'episode')}, {counted(writer.frames, 'frame')}")
    conclude_recording(written)
    if written.warnings:
        raise typer.Exit(1)
