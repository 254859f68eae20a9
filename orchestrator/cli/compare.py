"""`robogauntlet compare`: compare two policies, the policies of a run, or two runs."""

from __future__ import annotations

import re
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer

from robogauntlet.orchestrator.cli.common import StoreUrl, out, print_text
from robogauntlet.orchestrator.cli.console_tables import rich_table
from robogauntlet.results import api
from robogauntlet.results.analysis.comparison import Comparison, Difference, Verdict
from robogauntlet.results.report.comparison import BEGINS as RUNS_BEGIN
from robogauntlet.results.report.pairwise import BEGINS as POLICIES_BEGIN
from robogauntlet.results.report.pairwise import FORMATS as PAIRWISE_FORMATS
from robogauntlet.results.run_document import RunDocument
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.support.errors import BadInput
from robogauntlet.support.output_file import Output

COMPARISON = Output("a comparison", re.compile(RUNS_BEGIN.pattern + b"|" + POLICIES_BEGIN.pattern))
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
        min=0.0001,
        max=0.4999,
        help="Largest probability of a false alarm; of runs by default that of the suite, 0.05; of policies 0.05.",
    ),
]
Margin = Annotated[
    float | None,
    typer.Option(
        min=0.0001,
        max=0.9999,
        help="Loss of success that still counts as no worse (a share); for two runs by default that of the suite, "
        "0.05; for policies tested only if given.",
    ),
]
OutputFormat = Annotated[Format, typer.Option("--format", help="Output format.")]
OutFile = Annotated[
    Path | None,
    typer.Option("--out", help="File to write instead of printing; only an earlier comparison is replaced."),
]


def compare(
    run: Annotated[str, typer.Argument(help="A run folder, or a policy of it: RUN:POLICY.", metavar="RUN[:A]")],
    other: Annotated[
        str | None,
        typer.Argument(
            help="The run folder to compare it with, or a policy of this or another run. Without it, the policies of "
            "the run are compared with each other.",
            metavar="OTHER[:B]",
            show_default=False,
        ),
    ] = None,
    policy: Only = None,
    allow: Allow = None,
    alpha: Alpha = None,
    margin: Margin = None,
    form: OutputFormat = Format.TEXT,
    file: OutFile = None,
    store: StoreUrl = None,
) -> None:
    """Compare two policies, all policies of a run, or a run with a baseline run, episode by episode.

    RUN:A RUN:B (or OTHER:B) gives the difference of two policies with interval and exact test; RUN alone compares its
    policies with each other; RUN BASELINE looks for regressions of policies of the same name.
    A path with a colon is a run folder if it exists; RUN/:POLICY and RUN/ are never mistaken.

    Exit codes: 0 compared (no regression), 1 a regression, 2 not comparable.
    """
    check_output(file)
    (folder, first), (baseline, second) = parse_side(run), (None, None) if other is None else parse_side(other)
    options: dict[str, Any] = {"allowed": frozenset(allow or []), "alpha": alpha, "margin": margin}
    if first is None and second is None and baseline is not None:
        options["only"] = policy or []
        conclude(compare_folders(folder, baseline, store, options), form, file, tables=True)
    if form is Format.JUNIT:
        raise BadInput("--format junit: expected text, json or markdown for a comparison of policies")
    if first is not None and policy:
        raise BadInput(f"--policy: expected with a whole run only, {run} names a policy")
    if alpha is None:
        del options["alpha"]
    opened = api.open_run(folder, store)
    if other is None and first is None:
        check_policies(folder, opened.document, policy or [])
        write(PAIRWISE_FORMATS[form](opened.compare(*(policy or []), **options)), file)
        return
    if first is None or second is None or baseline is None:
        named, bare = (run, other) if second is None else (other, run)
        raise BadInput(
            f"expected two policies, RUN:A RUN:B; {named} names one{f' and {bare} names none' if bare else ''}"
        )
    beside = None if baseline == folder else api.open_run(baseline, store)
    check_policies(folder, opened.document, [first])
    check_policies(baseline, (beside or opened).document, [second])
    write(PAIRWISE_FORMATS[form](opened.compare(first, second, other=beside, **options)), file)


def parse_side(text: str) -> tuple[Path, str | None]:
    """Return the run folder and the policy of `RUN:POLICY`, or the run folder alone.

    Names of policies have neither a colon nor a slash, so that the last colon separates the two. Raises BadInput if
    both readings name an existing folder.
    """
    folder, colon, policy = text.rpartition(":")
    if not colon or not folder or not policy or "/" in policy:
        return Path(text), None
    if not Path(text).is_dir():
        return Path(folder), policy
    if Path(folder).is_dir():
        raise BadInput(
            f"{text}: expected a run folder or RUN:POLICY, it is both; write {text}/ for the folder, "
            f"{folder}/:{policy} for the policy"
        )
    return Path(text), None


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
    from robogauntlet.results.report.comparison import FORMATS, behaviour_tables, table

    text = FORMATS[form](comparison)
    if file is None:
        for policy in comparison.policies if tables and form is Format.TEXT else ():
            out.print(rich_table(table(policy, comparison.alpha), title=policy.policy))
            out.print()
            for moved in behaviour_tables(policy):
                out.print(rich_table(moved, title=policy.policy))
                out.print()
    write(text, file)
    raise typer.Exit(EXIT_CODES[comparison.verdict])


def write(text: str, file: Path | None) -> None:
    """Write a text into a file, or print it. Raises BadInput if the file cannot be written."""
    if file is None:
        print_text(text)
    else:
        COMPARISON.write(file, text)


def check_output(file: Path | None) -> None:
    """Raise BadInput if a comparison must not be written into the file."""
    if file is not None:
        COMPARISON.check(file)
