"""`robogauntlet compare`: compare two runs."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer

from robogauntlet.orchestrator.cli.common import RunArgument, StoreUrl, out
from robogauntlet.orchestrator.cli.console_tables import rich_table
from robogauntlet.results import api
from robogauntlet.results.analysis.comparison import Comparison, Difference, Verdict
from robogauntlet.results.run_document import RunDocument
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.support.errors import BadInput

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
    options = {"only": policy or [], "allowed": frozenset(allow or []), "alpha": alpha, "margin": margin}
    conclude(compare_folders(run, baseline, store, options), form, file, tables=True)


def compare_folders(run: Path, baseline: Path, store: str | None, options: dict[str, Any]) -> Comparison:
    """Compare two run folders with the options of `api.compare`; raises BadInput if a run lacks a policy."""
    sides = [api.open_run(folder, store) for folder in (run, baseline)]
    for side in sides:
        check_policies(side.folder, side.document, options["only"])
    return api.compare(*sides, **options)


def check_policies(folder: Path, document: RunDocument, policies: list[str]) -> None:
    """Raise BadInput unless a run has all these policies."""
    known = dict.fromkeys(cell.policy for cell in document.plan)
    for name in policies:
        if name not in known:
            raise BadInput(f"{folder}: the run has no policy '{name}'{did_you_mean(name, known)}")


def conclude(comparison: Comparison, form: Format, file: Path | None, *, tables: bool) -> NoReturn:
    """Write a comparison into a file or print it, if wanted after a table of each policy; exit with its code.

    Raises:
        BadInput: The file cannot be written.
    """
    from robogauntlet.results.report.comparison import FORMATS, table

    text = FORMATS[form](comparison)
    if file is not None:
        try:
            file.write_text(text, encoding="utf-8")
        except OSError as error:
            raise BadInput(f"{file}: cannot be written: {error.strerror}") from None
    else:
        for policy in comparison.policies if tables and form is Format.TEXT else ():
            out.print(rich_table(table(policy, comparison.alpha), title=policy.policy))
            out.print()
        out.print(text, markup=False, soft_wrap=True, end="")
    raise typer.Exit(EXIT_CODES[comparison.verdict])
