"""`gauntlet compare` and `gauntlet gate`: is a run worse than another, and can that be said."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from orchestrator.cli.shared import BadInput, HistoryUrl, StoreUrl, newest_run, open_history, out
from orchestrator.cli.tables import rich_table
from orchestrator.judging import judge
from results.comparison import Comparison, Difference, Verdict
from results.opening import compare as compare_folders
from results.opening import open_run
from results.run import RunDocument, RunError, read_run
from results.store import StoreError
from results.syncing import take_in_run
from suites.plugins import nearest

EXIT_CODES = {Verdict.REGRESSED: 1, Verdict.IMPROVED: 0, Verdict.NO_EVIDENCE: 0, Verdict.NOT_COMPARABLE: 2}


class Format(StrEnum):
    """How a comparison is told."""

    TEXT = "text"
    JSON = "json"
    MARKDOWN = "markdown"
    JUNIT = "junit"


Only = Annotated[list[str] | None, typer.Option("--policy", help="Only this policy. Repeatable.")]
Allow = Annotated[
    list[Difference] | None,
    typer.Option("--allow", help="Compare although this differs, and say so. Repeatable."),
]
Alpha = Annotated[
    float | None,
    typer.Option(min=0.0001, max=0.4999, help="Chance at most of a false alarm; by default the suite's, 0.05."),
]
Margin = Annotated[
    float | None,
    typer.Option(min=0.0001, max=0.9999, help="What counts as no worse; by default the suite's, 0.05."),
]
HowTold = Annotated[Format, typer.Option("--format", help="How to tell it.")]
OutFile = Annotated[Path | None, typer.Option("--out", help="File to write instead of the terminal.")]


def compare(
    run: Annotated[Path, typer.Argument(help="Run folder.")],
    baseline: Annotated[Path, typer.Argument(help="Run folder to hold it against.")],
    policy: Only = None,
    allow: Allow = None,
    alpha: Alpha = None,
    margin: Margin = None,
    told: HowTold = Format.TEXT,
    file: OutFile = None,
    store: StoreUrl = None,
) -> None:
    """Hold a run against another, episode by episode. Exit code 1: worse; 0: not; 2: not comparable."""
    found = _compared(run, baseline, policy or [], allow or [], alpha, margin, store)
    _tell(found, told, file)
    raise typer.Exit(EXIT_CODES[found.verdict])


def gate(
    run: Annotated[Path | None, typer.Argument(help="Run folder; by default the newest under runs/.")] = None,
    baseline: Annotated[
        Path | None,
        typer.Option(help="Run folder to hold it against; by default the last good one of its suite before it."),
    ] = None,
    policy: Only = None,
    allow: Allow = None,
    alpha: Alpha = None,
    margin: Margin = None,
    told: HowTold = Format.TEXT,
    file: OutFile = None,
    store: StoreUrl = None,
    url: HistoryUrl = None,
) -> None:
    """Hold a run against the one before it: verdict and reasons only. Exit code 1: worse; 0: not; 2: not comparable."""
    from results.report.comparison import as_text

    run = run or newest_run()
    if baseline is not None or store is not None:
        found = _compared(run, baseline or _missing(run), policy or [], allow or [], alpha, margin, store)
    else:
        found = _judged(run, policy or [], allow or [], alpha, margin, url)
    if told is Format.TEXT and file is None:
        out.print(as_text(found), markup=False, soft_wrap=True, end="")
    else:
        _tell(found, told, file)
    raise typer.Exit(EXIT_CODES[found.verdict])


def _compared(
    run: Path,
    baseline: Path,
    policies: list[str],
    allowed: list[Difference],
    alpha: float | None,
    margin: float | None,
    store: str | None,
) -> Comparison:
    try:
        sides = [open_run(folder, store) for folder in (run, baseline)]
        for side in sides:
            _check_names(side.folder, side.document, policies)
        return compare_folders(*sides, alpha=alpha, margin=margin, only=policies, allowed=frozenset(allowed))
    except (RunError, StoreError) as error:
        raise BadInput(str(error)) from None


def _missing(run: Path) -> Path:
    raise BadInput(f"{run}: with --store, name the run to hold it against with --baseline")


def _judged(
    run: Path,
    policies: list[str],
    allowed: list[Difference],
    alpha: float | None,
    margin: float | None,
    url: str | None,
) -> Comparison:
    """The run against the last good one of its suite, written into the history.

    Raises:
        BadInput: There is none, or one of them cannot be read.
    """
    try:
        document = read_run(run)
        _check_names(run, document, policies)
        with open_history(url, run.absolute().parent if url is None else None) as history:
            if history.find(document.run_id) is None:
                take_in_run(history, run, document)
            found = judge(history, document, run, alpha=alpha, margin=margin, only=policies, allowed=frozenset(allowed))
    except (RunError, StoreError) as error:
        raise BadInput(str(error)) from None
    if found is None:
        raise BadInput(
            f"{run}: expected a complete earlier run of suite '{document.suite_name}' beside it, found none; "
            "name one with --baseline"
        )
    return found


def _check_names(folder: Path, document: RunDocument, policies: list[str]) -> None:
    known = dict.fromkeys(cell.policy for cell in document.plan)
    for name in policies:
        if name not in known:
            raise BadInput(f"{folder}: it has no policy '{name}'{nearest(name, known)}")


def _tell(found: Comparison, told: Format, file: Path | None) -> None:
    from results.report.comparison import FORMATS, as_text, table

    if file is not None:
        try:
            file.write_text(FORMATS[told](found), encoding="utf-8")
        except OSError as error:
            raise BadInput(f"{file}: cannot be written: {error.strerror}") from None
        return
    if told is not Format.TEXT:
        out.print(FORMATS[told](found), markup=False, soft_wrap=True, end="")
        return
    for one in found.policies:
        out.print(rich_table(table(one, found.alpha), title=one.policy))
        out.print()
    out.print(as_text(found), markup=False, soft_wrap=True, end="")
