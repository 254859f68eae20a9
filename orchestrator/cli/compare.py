"""`robogauntlet compare`: compare two runs."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from robogauntlet.orchestrator.cli.common import BadInput, RunArgument, StoreUrl, out
from robogauntlet.orchestrator.cli.console_tables import rich_table
from robogauntlet.results import api
from robogauntlet.results.analysis.comparison import Comparison, Difference, Verdict
from robogauntlet.results.run_document import RunDocument, RunError
from robogauntlet.results.store.episode_store import StoreError
from robogauntlet.suites.plugins import did_you_mean

EXIT_CODES = {Verdict.REGRESSED: 1, Verdict.IMPROVED: 0, Verdict.NO_EVIDENCE: 0, Verdict.NOT_COMPARABLE: 2}


class Format(StrEnum):
    """Output format of a comparison."""

    TEXT = "text"
    JSON = "json"
    MARKDOWN = "markdown"
    JUNIT = "junit"


Only = Annotated[list[str] | None, typer.Option("--policy", help="Only this policy. Repeatable.")]
Allow = Annotated[
    list[Difference] | None,
    typer.Option("--allow", help="Compare the runs although this differs; the result mentions it. Repeatable."),
]
Alpha = Annotated[
    float | None,
    typer.Option(
        min=0.0001, max=0.4999, help="Largest probability of a false alarm; by default that of the suite, 0.05."
    ),
]
Margin = Annotated[
    float | None,
    typer.Option(
        min=0.0001,
        max=0.9999,
        help="Loss of success that still counts as no worse (a share); by default that of the suite, 0.05.",
    ),
]
OutputFormat = Annotated[Format, typer.Option("--format", help="Output format.")]
OutFile = Annotated[Path | None, typer.Option("--out", help="File to write instead of printing.")]


def compare(
    run: RunArgument,
    baseline: Annotated[Path, typer.Argument(help="Run folder to compare it with.")],
    policy: Only = None,
    allow: Allow = None,
    alpha: Alpha = None,
    margin: Margin = None,
    form: OutputFormat = Format.TEXT,
    file: OutFile = None,
    store: StoreUrl = None,
) -> None:
    """Compare a run with a baseline run, episode by episode.

    Exit codes: 0 no regression, 1 a regression, 2 not comparable.
    """
    comparison = compare_folders(run, baseline, policy or [], allow or [], alpha, margin, store)
    write_comparison(comparison, form, file)
    raise typer.Exit(EXIT_CODES[comparison.verdict])


def compare_folders(
    run: Path,
    baseline: Path,
    policies: list[str],
    allowed: list[Difference],
    alpha: float | None,
    margin: float | None,
    store: str | None,
) -> Comparison:
    """Compare two run folders.

    Raises:
        BadInput: One of them cannot be read, or lacks a policy.
    """
    try:
        sides = [api.open_run(folder, store) for folder in (run, baseline)]
        for side in sides:
            check_policies(side.folder, side.document, policies)
        return api.compare(*sides, alpha=alpha, margin=margin, only=policies, allowed=frozenset(allowed))
    except (RunError, StoreError) as error:
        raise BadInput(str(error)) from None


def check_policies(folder: Path, document: RunDocument, policies: list[str]) -> None:
    """Check that a run has all these policies.

    Raises:
        BadInput: The run lacks one of them.
    """
    known = dict.fromkeys(cell.policy for cell in document.plan)
    for name in policies:
        if name not in known:
            raise BadInput(f"{folder}: the run has no policy '{name}'{did_you_mean(name, known)}")


def write_comparison(comparison: Comparison, form: Format, file: Path | None) -> None:
    """Print a comparison, or write it into a file.

    Raises:
        BadInput: The file cannot be written.
    """
    from robogauntlet.results.report.comparison import FORMATS, as_text, table

    if file is not None:
        try:
            file.write_text(FORMATS[form](comparison), encoding="utf-8")
        except OSError as error:
            raise BadInput(f"{file}: cannot be written: {error.strerror}") from None
        return
    if form is not Format.TEXT:
        out.print(FORMATS[form](comparison), markup=False, soft_wrap=True, end="")
        return
    for policy in comparison.policies:
        out.print(rich_table(table(policy, comparison.alpha), title=policy.policy))
        out.print()
    out.print(as_text(comparison), markup=False, soft_wrap=True, end="")
