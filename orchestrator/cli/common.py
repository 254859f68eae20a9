"""Consoles, options, exit codes and messages that the verbs share."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from robogauntlet.adapters.contract import AdapterError
from robogauntlet.orchestrator.runs.composition import RUNS
from robogauntlet.orchestrator.runs.suite_names import PlanError
from robogauntlet.policies.contract import PolicyError
from robogauntlet.policies.references import FORMS
from robogauntlet.results.folder_lock import FolderError
from robogauntlet.results.run_document import RUN_FILE, RunError
from robogauntlet.results.store.database import StoreError, parse
from robogauntlet.results.store.history_import import record_run_folders
from robogauntlet.results.store.run_history import History, history_url
from robogauntlet.suites.episode import RenderProfile, SuccessRule
from robogauntlet.suites.loading import SuiteError
from robogauntlet.suites.ranges import LARGEST_IMAGE, MAX_SEEDS, MAX_STEPS, MAX_WORKERS, SMALLEST_IMAGE
from robogauntlet.suites.selection import SETTINGS, SelectionError
from robogauntlet.suites.timing import read_timing
from robogauntlet.support.errors import BadInput
from robogauntlet.support.interrupts import EXIT_INTERRUPTED as EXIT_INTERRUPTED
from robogauntlet.support.text import visible

INPUT_ERRORS = (
    BadInput,
    SuiteError,
    SelectionError,
    PlanError,
    PolicyError,
    AdapterError,
    FolderError,
    RunError,
    StoreError,
)
"""Exceptions whose messages are for the user. `main` prints them and exits with `EXIT_BAD_INPUT`."""
EXIT_BAD_INPUT = 2
EXIT_STOPPED = 3

TAB = "\t"
out = Console(highlight=False)
err = Console(stderr=True, highlight=False)
if not out.is_terminal and "COLUMNS" not in os.environ:
    out.width = 160  # files and pipes have no width

RunArgument = Annotated[Path, typer.Argument(help="Run folder.")]
NewestRunArgument = Annotated[
    Path | None, typer.Argument(metavar="RUN", help="Run folder; by default the newest one under runs/.")
]
Policies = Annotated[
    list[str] | None,
    typer.Option(
        "--policy",
        help="Only this policy of the suite, or policies that match a pattern; or another policy instead: "
        f"{FORMS}. Repeatable.",
    ),
]
Tasks = Annotated[
    list[str] | None,
    typer.Option("--task", help="Only this task (simulator/task), or tasks that match a pattern. Repeatable."),
]
SeedCount = Annotated[
    int | None, typer.Option("--seeds", min=1, max=MAX_SEEDS, help="Only the first N seeds of the suite.")
]
Success = Annotated[
    SuccessRule | None,
    typer.Option(
        help="When an episode is a success: its predicate has held for 5 steps, or once; by default as the suite says.",
        show_default=False,
    ),
]
ImageSizeSetting = Annotated[
    int | None,
    typer.Option(
        "--image-size",
        min=SMALLEST_IMAGE,
        max=LARGEST_IMAGE,
        help="Height and width of frames (px), if the suite does not state it; by default as the policies ask.",
    ),
]
ReplanEvery = Annotated[
    int | None,
    typer.Option(
        "--replan-every",
        min=1,
        max=MAX_STEPS,
        help="Actions of a chunk that are executed before the policy is asked again, if the suite does not state it.",
    ),
]
RenderProfileSetting = Annotated[
    RenderProfile | None, typer.Option("--render-profile", help="Detail of rendering, if the suite does not state it.")
]
WorkersSetting = Annotated[
    str | None,
    typer.Option("--workers", metavar="N|auto", help="Worker processes of each simulator, whatever the suite states."),
]
Latency = Annotated[
    str | None,
    typer.Option(
        "--latency",
        metavar="[MODE:]MS",
        help="How long answers take in simulated time, if the suite does not state it: 80ms, or 80-140ms (median and "
        "95th percentile), or `measured` first. Meanwhile the robot does what MODE says: hold, continue or blend.",
    ),
]
PolicyOptions = Annotated[
    list[str] | None, typer.Option("--option", metavar="NAME=VALUE", help="Option of the policy, in YAML. Repeatable.")
]
StoreUrl = Annotated[
    str | None, typer.Option("--store", help="URL of the store with the run's rows, if it is not in the run folder.")
]
OwnSuite = Annotated[
    str | None,
    typer.Option(
        "--suite", help="Suite with the policies to play; needed for a run that you did not play in this folder."
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]
TOKEN = "ROBOGAUNTLET_TOKEN"
Host = Annotated[
    str, typer.Option(help=f"Address to listen on. Addresses other than loopback need a token in {TOKEN}.")
]
Port = Annotated[int, typer.Option(min=0, max=65535, help="Port to listen on; 0 for any free port.")]
HistoryUrl = Annotated[
    str | None,
    typer.Option(
        "--history",
        envvar="ROBOGAUNTLET_HISTORY",
        show_envvar=True,
        help="URL of the history, the store that lists all runs; by default history.sqlite beside the run folders.",
    ),
]


def suite_settings(
    success: SuccessRule | None,
    image_size: int | None,
    replan_every: int | None,
    render_profile: RenderProfile | None,
    workers: str | None,
    latency: str | None,
) -> dict[str, Any]:
    """Return what is given of `SETTINGS`, as in a suite. Raises BadInput if `workers` or `latency` is none."""
    count: int | str | None = int(workers) if workers is not None and workers.isdecimal() else workers
    if (isinstance(count, int) and not 1 <= count <= MAX_WORKERS) or (isinstance(count, str) and count != "auto"):
        raise BadInput(f"--workers: expected auto, or a number from 1 to {MAX_WORKERS}, got '{workers}'")
    try:
        timing = read_timing(latency)
    except ValueError as error:
        raise BadInput(f"--latency: {error}") from None
    given = dict(zip(SETTINGS, (success, image_size, replan_every, render_profile, count, timing), strict=True))
    return {name: value for name, value in given.items() if value is not None}


def refuse(mode: str, given: Mapping[str, Any]) -> None:
    """Raise BadInput if a value is given, by the name of its option, that `mode` has no use for."""
    if unused := next((name for name, value in given.items() if value is not None and value is not False), None):
        raise BadInput(f"{unused}: expected without {mode}")


def fail(message: str) -> None:
    """Print each line of a message to standard error, unprintable characters as escapes."""
    for line in message.splitlines():
        err.print(f"robogauntlet: {visible(line, TAB)}", markup=False, soft_wrap=True)


def print_line(line: str) -> None:
    """Print a line to standard output without markup and wrapping, unprintable characters as escapes."""
    print_text(line + "\n")


def print_text(text: str) -> None:
    """Print lines to standard output without markup and wrapping, unprintable characters as escapes."""
    out.print(visible(text, "\n" + TAB), markup=False, soft_wrap=True, end="")


def print_json(value: Any) -> None:
    """Print plain values and dataclasses as JSON to standard output."""
    print_line(json.dumps(value, indent=1, default=lambda it: dataclasses.asdict(it)))


def newest_run(root: Path = RUNS) -> Path:
    """Return the run folder under `root` that was changed last. Raises BadInput if there is none."""
    newest = max(root.glob(f"*/{RUN_FILE}"), key=lambda path: path.stat().st_mtime, default=None)
    if newest is None:
        raise BadInput(f"no run under {root}/; name one")
    return newest.parent


def runs_root(url: str | None) -> Path:
    """Return the folder of the run folders: the folder of a history that is a file, else `runs`."""
    parsed = parse(history_url(url, RUNS))
    return Path(parsed.database).parent if parsed.get_backend_name() == "sqlite" and parsed.database else RUNS


@contextmanager
def open_history(url: str | None, root: Path | None = None) -> Iterator[History]:
    """Open the history at `url` and record in it the runs under `root` that it does not list yet.

    Raises:
        BadInput: The folder cannot be written.
        StoreError: The history cannot be opened, read or written.
    """
    root = root or runs_root(url)
    file = _history_file(url, root)
    is_new, is_new_root, is_refused = file is not None and not file.exists(), not root.exists(), False
    try:
        if url is None:
            root.mkdir(parents=True, exist_ok=True)
        with closing(History.open(history_url(url, root))) as history:
            record_run_folders(history, root, fail)
            try:
                yield history
            except BadInput:
                is_refused = is_new and not history.runs(limit=1)
                raise
    except OSError as error:
        raise BadInput(f"{root}: {error.strerror}") from None
    finally:
        if is_refused and file is not None:  # a mistake leaves nothing behind
            file.unlink(missing_ok=True)
            if is_new_root:
                with suppress(OSError):
                    root.rmdir()


def _history_file(url: str | None, root: Path) -> Path | None:
    parsed = parse(history_url(url, root))
    return Path(parsed.database) if parsed.get_backend_name() == "sqlite" and parsed.database else None
