"""`robogauntlet compare`: compare policies, runs, and a run with its baseline."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer

from robogauntlet.orchestrator.cli.common import (
    HistoryUrl,
    StoreUrl,
    fail,
    newest_run,
    open_history,
    out,
    print_json,
    print_line,
    print_text,
    refuse,
)
from robogauntlet.orchestrator.cli.console_tables import rich_table
from robogauntlet.orchestrator.runs.regression_check import check_regression
from robogauntlet.results import api
from robogauntlet.results.analysis import latency_budget
from robogauntlet.results.analysis.comparison import Difference, RunComparison, Verdict
from robogauntlet.results.report.comparison import BEGINS, render, tables
from robogauntlet.results.report.formatting import points
from robogauntlet.results.report.sections.latency import DOING
from robogauntlet.results.run_document import RunDocument, read_run, refuse_imported
from robogauntlet.results.statistics.multiplicity import ALPHA
from robogauntlet.results.store.foreign.trials import task_name
from robogauntlet.results.store.history_import import record_run_folder
from robogauntlet.results.store.run_history import SHORTEST_ID
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.support.errors import BadInput
from robogauntlet.support.output_file import Output

COMPARISON = Output("a comparison", BEGINS)
EXIT_CODES = {
    Verdict.REGRESSED: 1,
    Verdict.IMPROVED: 0,
    Verdict.NO_EVIDENCE: 0,
    Verdict.SEPARATE: 0,
    Verdict.NOT_COMPARABLE: 2,
}


class Format(StrEnum):
    """Output format of a comparison."""

    TEXT = "text"
    JSON = "json"
    MARKDOWN = "markdown"


def compare(
    run: Annotated[
        str | None,
        typer.Argument(
            metavar="RUN[:A]",
            help="A run folder, by default the newest one under runs/, or a policy of it. With --all, the name of a "
            f"suite; with --accept, also {SHORTEST_ID} or more characters of a run's id.",
            show_default=False,
        ),
    ] = None,
    other: Annotated[
        str | None,
        typer.Argument(
            metavar="OTHER[:B]",
            help="The run folder to compare it with, or a policy of this or another run. Without it, the policies of "
            "the run are compared with each other.",
            show_default=False,
        ),
    ] = None,
    gate: Annotated[
        bool,
        typer.Option(
            "--gate", help="Check the run for regressions against OTHER, by default the last good run of its suite."
        ),
    ] = False,
    everything: Annotated[
        bool,
        typer.Option(
            "--all", help="Compare the policies of a suite, by default that of the newest run, by their newest runs."
        ),
    ] = False,
    latency: Annotated[
        float | None,
        typer.Option(
            "--latency",
            metavar="MS",
            help="Check that each policy of the run keeps its success when answers take this much longer; the run has "
            "an axis of latency at this level.",
        ),
    ] = None,
    accept: Annotated[
        bool, typer.Option("--accept", help="Make the run the baseline of later runs; nothing is compared.")
    ] = False,
    policy: Annotated[list[str] | None, typer.Option("--policy", help="Only this policy. Repeatable.")] = None,
    allow: Annotated[
        list[Difference] | None,
        typer.Option("--allow", help="Compare the runs although this differs; the result mentions it. Repeatable."),
    ] = None,
    task: Annotated[
        list[str] | None,
        typer.Option(
            "--task",
            metavar="TASK=OTHER",
            help="A task of RUN and its name in OTHER, of runs whose trials are not paired. Repeatable.",
        ),
    ] = None,
    alpha: Annotated[
        float | None,
        typer.Option(
            min=0.0001,
            max=0.4999,
            help="Largest probability of a false alarm; of runs by default that of the suite, 0.05; of policies 0.05.",
        ),
    ] = None,
    margin: Annotated[
        float | None,
        typer.Option(
            min=0.0001,
            max=0.9999,
            help="Loss of success that still counts as no worse (a share); for two runs by default that of the suite, "
            "0.05; for policies tested only if given.",
        ),
    ] = None,
    imported: Annotated[bool, typer.Option("--imported", help="With --all: runs of others, too, marked.")] = False,
    form: Annotated[Format, typer.Option("--format", help="Output format.")] = Format.TEXT,
    file: Annotated[
        Path | None,
        typer.Option("--out", help="File to write instead of printing; only an earlier comparison is replaced."),
    ] = None,
    store: StoreUrl = None,
    url: HistoryUrl = None,
) -> None:
    """Compare policies, or a run with its baseline, episode by episode.

    RUN:A RUN:B (or OTHER:B) gives the difference of two policies with interval and exact test; RUN alone compares its
    policies with each other; RUN BASELINE looks for regressions of policies of the same name, and so does RUN --gate,
    which prints the verdict and the reasons only. Of runs whose trials are not paired, such as SIMULATED REAL, it gives
    the difference of each policy, and how well the first predicts the second.
    A path with a colon is a run folder if it exists; RUN/:POLICY and RUN/ are never mistaken.

    Exit codes: 0 compared (no regression), 1 a regression, or success not kept under --latency, 2 not comparable.
    """
    mode = _mode({"--gate": gate, "--all": everything, "--accept": accept, "--latency": latency is not None})
    given = {"OTHER": other, "--policy": policy, "--allow": allow, "--margin": margin, "--out": file, "--store": store}
    given |= {"--task": task}
    if mode == "--accept":
        refuse(mode, given | {"--alpha": alpha, "--imported": imported})
        _accept(run, url)
        return
    if mode == "--all":
        refuse(mode, given)
        _print_leaderboard(run, alpha or ALPHA, form, url, imported=imported)
        return
    if imported:
        raise BadInput("--imported: expected with --all")
    if latency is not None:
        refuse(mode or "", {"OTHER": other, "--allow": allow, "--task": task, "--alpha": alpha, "--out": file})
        _hold_to_budget(newest_run() if run is None else Path(run), latency, policy or [], margin, form, store)
        return
    if file is not None:
        COMPARISON.check(file)
    options: dict[str, Any] = {"allowed": frozenset(allow or []), "alpha": alpha, "margin": margin}
    if mode == "--gate":
        refuse(mode, {"--task": task})
        folder = newest_run() if run is None else Path(run)
        options["only"] = policy or []
        _conclude(
            _with_baseline(folder, Path(other) if other else None, store, url, options), form, file, with_tables=False
        )
    run = run or str(newest_run())
    (folder, first), (baseline, second) = parse_side(run), (None, None) if other is None else parse_side(other)
    if first is None and second is None and baseline is not None:
        options |= {"only": policy or [], "tasks": _same_tasks(task or [])}
        _conclude(_of_folders(folder, baseline, store, options), form, file, with_tables=True)
    if task:
        raise BadInput("--task: expected with two whole runs, RUN OTHER")
    if first is not None and policy:
        raise BadInput(f"--policy: expected with a whole run only, {run} names a policy")
    if alpha is None:
        del options["alpha"]
    opened = api.open_run(folder, store)
    if other is None and first is None:
        _check_policies(folder, opened.document, policy or [])
        _write(render(opened.compare(*(policy or []), **options), form), file)
        return
    if first is None or second is None or baseline is None:
        named, bare = (run, other) if second is None else (other, run)
        raise BadInput(
            f"expected two policies, RUN:A RUN:B; {named} names one{f' and {bare} names none' if bare else ''}"
        )
    beside = None if baseline == folder else api.open_run(baseline, store)
    _check_policies(folder, opened.document, [first])
    _check_policies(baseline, (beside or opened).document, [second])
    _write(render(opened.compare(first, second, other=beside, **options), form), file)


def _mode(given: Mapping[str, bool]) -> str | None:
    """The one of the options that is given. Raises BadInput if several are."""
    modes = [name for name, is_given in given.items() if is_given]
    if len(modes) > 1:
        raise BadInput(f"expected one of {', '.join(given)}, got {' and '.join(modes)}")
    return modes[0] if modes else None


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


def _same_tasks(given: list[str]) -> dict[str, str]:
    """Tasks of the run to those of the other, from texts `TASK=OTHER`. Raises BadInput."""
    tasks = {}
    for text in given:
        own, equals, other = (part.strip() for part in text.partition("="))
        if not own or not equals or not other or task_name(own) in tasks:
            wanted = "each task once" if own and other else "TASK=OTHER"
            raise BadInput(f"--task: expected {wanted}, got '{text}'")
        tasks[task_name(own)] = task_name(other)
    return tasks


def _of_folders(run: Path, baseline: Path, store: str | None, options: dict[str, Any]) -> RunComparison:
    """Compare two run folders with the options of `api.compare`; raises BadInput if a run lacks a policy."""
    sides = [api.open_run(folder, store) for folder in (run, baseline)]
    for side in sides:
        _check_policies(side.folder, side.document, options["only"])
    return api.compare(*sides, **options)


def _with_baseline(
    run: Path, baseline: Path | None, store: str | None, url: str | None, options: dict[str, Any]
) -> RunComparison:
    """Compare the run with a baseline, by default the last good one of its suite, whose verdict the history keeps."""
    if baseline is not None:
        refuse_imported(baseline, read_run(baseline), "a baseline")
    document = read_run(run)
    if document.is_outcomes_only:
        raise BadInput(
            f"--gate: expected a run that was played, {run} has results of others; compare it without --gate"
        )
    if baseline is not None:
        return _of_folders(run, baseline, store, options)
    if store is not None:
        raise BadInput(
            f"{run}: with --store, name the run to compare it with: robogauntlet compare {run} BASELINE --gate"
        )
    _check_policies(run, document, options["only"])
    with open_history(url, run.absolute().parent if url is None else None) as history:
        if history.find(document.run_id) is None:
            record_run_folder(history, run, document)
        comparison = check_regression(history, document, run, **options)
    if comparison is None:
        raise BadInput(
            f"{run}: expected a complete earlier run of suite '{document.suite.name}' beside it, found none "
            f"that counts success {document.suite.success_rule}; name one: robogauntlet compare {run} BASELINE --gate"
        )
    return comparison


def _hold_to_budget(
    folder: Path, latency: float, only: list[str], margin: float | None, form: Format, store: str | None
) -> None:
    """Print how each policy does at a latency, in each mode that the run has; exit with 1 if one does not keep it."""
    if form not in (Format.TEXT, Format.JSON):
        raise BadInput(f"--format {form}: expected text or json with --latency")
    run = api.open_run(folder, store)
    _check_policies(folder, run.document, only)
    rows = run.episodes(latency_budget.COLUMNS)
    rows = rows[rows["policy"].isin(only)] if only else rows
    if latency not in (played := latency_budget.latencies_in(rows)):
        has = f"has {', '.join(f'{one:g}' for one in played)} ms" if played else "has no axis of latency"
        raise BadInput(f"--latency: expected a latency that {folder} has played, it {has}; got {latency:g}")
    margin = run.document.suite.regression.margin if margin is None else margin
    found = list(latency_budget.within_budget(rows, latency, margin))
    if form is Format.JSON:
        print_json(found)
    for one in found if form is Format.TEXT else ():
        verdict = f"{'keeps' if one.is_kept else 'is not shown to keep'} its success within {100 * margin:g} points"
        rates = f"{one.clean} of {one.trials} without latency, {one.late} with it, {points(one.change)} points"
        print_line(f"{one.policy}, robot {DOING[one.mode]} for {latency:g} ms: {verdict} ({rates})")
    if not all(one.is_kept for one in found):
        raise typer.Exit(1)


def _accept(run: str | None, url: str | None) -> None:
    """Make a run the baseline: one that is correct although it was found worse than its baseline or not comparable."""
    if run is None:
        raise BadInput("--accept: expected the run that becomes the baseline")
    with open_history(url) as history:
        entry = history.find(Path(run).name)
        if entry is None:
            raise BadInput(f"no run '{run}' in the history; see: robogauntlet list runs")
        if entry.imported:
            raise BadInput(f"{entry.name}: a run of others is no baseline; run its suite file: robogauntlet run SUITE")
        history.accept(entry.run_id)
    print_line(f"{entry.name}: later runs of {entry.suite} are compared with it")


def _print_leaderboard(suite: str | None, alpha: float, form: Format, url: str | None, *, imported: bool) -> None:
    """Print the policies of a suite by their newest complete runs; tasks that only some have played do not count."""
    from robogauntlet.results.analysis.leaderboard import leaderboard
    from robogauntlet.results.analysis.unpaired import states_known
    from robogauntlet.results.newest_results import latest_results_per_policy
    from robogauntlet.results.report.history_tables import leaderboard_table

    if form not in (Format.TEXT, Format.JSON):
        raise BadInput(f"--format {form}: expected text or json with --all")
    with open_history(url) as history:
        suites = history.suites()
        if suite is None:
            newest = history.runs(limit=1)
            if not newest:
                raise BadInput("no run in the history; name the suite of one that is: --all SUITE --history URL")
            suite = newest[0].suite
        if suite not in suites:
            raise BadInput(f"no run of a suite '{suite}'{did_you_mean(suite, suites)}")
        results = list(latest_results_per_policy(history, suite, fail, imported=imported))
    if not results:
        others = "" if imported else "; runs of others count with --imported"
        raise BadInput(f"expected a complete run of suite '{suite}', found none{others}")
    rows = leaderboard(results, alpha)
    if form is Format.JSON:
        print_json(rows)
        return
    out.print(rich_table(leaderboard_table(rows), title=f"{suite}, clean episodes"))
    test = "McNemar" if all(states_known(one.rows) for one in results) else "McNemar, or Fisher on separate trials"
    print_line(f"\nPolicies that share a letter do not differ significantly ({test}, Holm, alpha {alpha:g}).")


def _check_policies(folder: Path, document: RunDocument, policies: list[str]) -> None:
    """Raise BadInput unless a run has all these policies."""
    known = dict.fromkeys(cell.policy for cell in document.plan)
    for name in policies:
        if name not in known:
            raise BadInput(f"{folder}: the run has no policy '{name}'{did_you_mean(name, known)}")


def _conclude(comparison: RunComparison, form: Format, file: Path | None, *, with_tables: bool) -> NoReturn:
    """Write a comparison into a file or print it, if wanted after a table of each policy; exit with its code.

    Raises:
        BadInput: The file cannot be written.
    """
    for title, own in tables(comparison) if file is None and with_tables and form is Format.TEXT else ():
        for shown in own:
            out.print(rich_table(shown, title=title))
            out.print()
    _write(render(comparison, form), file)
    raise typer.Exit(EXIT_CODES[comparison.verdict])


def _write(text: str, file: Path | None) -> None:
    """Write a text into a file, or print it. Raises BadInput if the file cannot be written."""
    if file is None:
        print_text(text)
    else:
        COMPARISON.write(file, text)
