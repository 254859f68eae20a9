"""Public API for notebooks and scripts: open a run, read its episodes as a table, compare policies and runs."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence, Set
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from robogauntlet.results.analysis import comparison as analysis, pairwise
from robogauntlet.results.analysis.comparison import COLUMNS, Difference, Run, RunComparison, compare_runs
from robogauntlet.results.analysis.pairwise import PolicyComparisons, PolicyRows
from robogauntlet.results.analysis.separate_runs import SeparateRuns, are_separate, compare_separate_runs
from robogauntlet.results.analysis.tables import Tables, build_tables
from robogauntlet.results.record import FIELDS
from robogauntlet.results.run_document import RunDocument, RunError, read_run
from robogauntlet.results.statistics.multiplicity import ALPHA
from robogauntlet.results.store.episode_frame import frame_of
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.history_records import RunEntry, rows_url
from robogauntlet.results.store.run_history import History
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.support.text import counted

if TYPE_CHECKING:
    import pandas as pd


TABLE = ("policy", "task", "condition", "success", "low", "high", "n", "errors", "missing")
"""Columns of `OpenRun.table`."""


class OpenRun:
    """A run folder with its episodes."""

    def __init__(self, folder: Path, document: RunDocument, store: str | None) -> None:
        """See `open_run`."""
        self.folder, self.document, self._store = folder, document, store

    def __repr__(self) -> str:
        document = self.document
        planned = counted(document.planned, "episode")
        return f"{self.folder}: suite {document.suite.name}, {planned} planned, {document.status}"

    def __str__(self) -> str:
        numbers = self.table().to_string(index=False, float_format="{:.2f}".format, na_rep="-")
        return f"{self!r}\n{numbers}"

    def table(self) -> pd.DataFrame:
        """Return success per policy, task and condition.

        Columns: `policy`, `task`, `condition`; `success`, the rate from 0 to 1, with `low` and `high`, the ends of its
        95 % Wilson interval (NaN without an episode that counts); `n`, the episodes that count; `errors` and `missing`,
        those that could not be played or were not.
        """
        import pandas as pd

        rows = []
        for cell in self.tables().cells:
            tally, interval = cell.tally, cell.tally.interval
            low, high = (interval.low, interval.high) if interval else (None, None)
            rates = (tally.rate, low, high, tally.verdicts, tally.errors, tally.missing)
            rows.append((cell.policy, cell.task, str(cell.condition), *rates))
        frame = pd.DataFrame(rows, columns=list(TABLE))
        return frame.astype({"success": float, "low": float, "high": float})

    def _repr_html_(self) -> str:
        numbers = self.table().to_html(index=False, border=0, float_format="{:.2f}".format, na_rep="-")
        return f"<p>{html.escape(repr(self))}</p>{numbers}"

    def episodes(self, fields: Sequence[str] = FIELDS) -> pd.DataFrame:
        """Return a table with a row per episode and a column per field of `robogauntlet.EpisodeResult`.

        Raises:
            RunError: A field that episodes do not have, or the rows are in a database whose URL was not given.
            StoreError: The rows cannot be read.
        """
        if unknown := [name for name in fields if name not in FIELDS]:
            raise RunError(f"expected fields of an episode, got '{unknown[0]}'{did_you_mean(unknown[0], FIELDS)}")
        return frame_of(Store.open_begun(self.folder, self.document, self._store), fields)

    def tables(self) -> Tables:
        """Return success per task, simulator and policy with intervals, as in the report."""
        return build_tables(self.document, self.episodes())

    def compare(
        self,
        *policies: str,
        other: OpenRun | Path | str | None = None,
        alpha: float = ALPHA,
        margin: float | None = None,
        allowed: Set[Difference] = frozenset(),
    ) -> ComparedPolicies:
        """Compare policies with each other on the episodes that they share: `run.compare("a", "b")`.

        `print` shows the result as text; notebooks show it as tables.

        Args:
            policies: Two names: the first is compared with the second. Without a name, or with three or more: these
                policies of the run, each with the baseline of the suite's `compare`, or all pairs without one.
            other: The run that has the second policy, or its folder; by default this run.
            alpha: Significance level of the adjusted p-values; the confidence of intervals is 1 - alpha.
            margin: Largest decrease of a rate, a share between 0 and 1, that counts as no worse; None to test none.
            allowed: Differences of the two runs that do not prevent the comparison.

        Raises:
            RunError: A policy that the run does not have, or a single policy.
            NotComparable: The two share no episode, or their runs differ in what is not allowed.
            StoreError: Rows cannot be read.
            ValueError: alpha or margin outside (0, 1).
        """
        if len(policies) == 1 or (other is not None and len(policies) != 2):
            raise RunError(f"{self.folder}: expected two policies to compare, got {', '.join(policies) or 'none'}")
        if other is None and len(policies) != len(set(policies)):
            raise RunError(f"{self.folder}: expected different policies to compare, got {', '.join(policies)}")
        run = self._for_comparison(pairwise.COLUMNS)
        if len(policies) != 2:
            found = pairwise.compare_all(run, only=policies, alpha=alpha, margin=margin)
        else:
            opened = other if other is None or isinstance(other, OpenRun) else open_run(other)
            second = run if opened is None else opened._for_comparison(pairwise.COLUMNS)
            runs = _apart((self, opened or self), (run, second))
            sides = [PolicyRows.of_run(one, name) for one, name in zip(runs, policies, strict=True)]
            found = pairwise.compare_policies(*sides, alpha=alpha, margin=margin, allowed=allowed)
        return ComparedPolicies(**vars(found))

    def _for_comparison(self, fields: Sequence[str]) -> Run:
        return Run(self.folder.absolute().name, self.document, self.episodes(fields))


def open_run(folder: Path | str, store: str | None = None) -> OpenRun:
    """Open a run folder; `store` is the URL of its store, if that is not in the folder.

    Raises:
        RunError: The folder is not a run folder.
    """
    return OpenRun(Path(folder), read_run(Path(folder)), store)


def open_entry(history: History, entry: RunEntry, document: RunDocument | None = None) -> OpenRun:
    """Open a run of a history; without `document`, read it from the history.

    Raises:
        RunError: Its rows are not accessible.
        StoreError: The history cannot be read.
    """
    if entry.folder is None and entry.rows_url is None:
        raise RunError(f"{entry.name}: expected its folder with the rows, but the folder was removed")
    url = rows_url(entry, history.url)
    return OpenRun(Path(entry.folder or entry.name), document or history.document(entry.run_id), url)


class Comparison(analysis.Comparison):
    """What was compared, see `kind`, and what was found. Prints itself: as text, and in notebooks as Markdown."""

    def __str__(self) -> str:
        from robogauntlet.results.report.comparison import render

        return render(self)

    def _repr_markdown_(self) -> str:
        from robogauntlet.results.report.comparison import render

        return render(self, "markdown")


class ComparedRuns(Comparison, RunComparison):
    """A `Comparison` of a run with a baseline run."""


class ComparedSeparately(ComparedRuns, SeparateRuns):
    """A `Comparison` of two runs whose trials are not paired."""


class ComparedPolicies(Comparison, PolicyComparisons):
    """A `Comparison` of policies with each other."""


def compare(
    run: OpenRun | Path | str,
    baseline: OpenRun | Path | str,
    *,
    alpha: float | None = None,
    margin: float | None = None,
    only: Sequence[str] = (),
    allowed: Set[Difference] = frozenset(),
    tasks: Mapping[str, str] | None = None,
) -> ComparedRuns:
    """Compare a run with a baseline run: paired tests per task and policy, adjusted for multiplicity.

    Trials of others that are not paired are compared as separate ones, see `ComparedSeparately`.

    `print` shows the result as text; notebooks show it as a table.

    Args:
        run: A run or its folder.
        baseline: The run to compare with.
        alpha: Maximum probability of a false alarm; by default that of the run's suite.
        margin: Largest decrease of a rate that counts as no worse; by default that of the run's suite, and none is
            tested of runs that are not paired.
        only: Names of policies; empty for all.
        allowed: Differences of the runs that do not prevent the comparison.
        tasks: Tasks of the run to their names in the baseline where these differ, of runs that are not paired.

    Raises:
        RunError: A folder is not a run folder, or both are the same; or a task that a run does not have.
        StoreError: Rows cannot be read.
    """
    runs = [given if isinstance(given, OpenRun) else open_run(given) for given in (run, baseline)]
    if runs[0].folder.resolve() == runs[1].folder.resolve():
        raise RunError(f"{runs[1].folder}: expected another run to compare with, this is the run itself")
    defaults = runs[0].document.suite.regression
    alpha = defaults.alpha if alpha is None else alpha
    fields = pairwise.COLUMNS if any(one.document.is_outcomes_only for one in runs) else COLUMNS
    sides = _apart(runs, [side._for_comparison(fields) for side in runs])
    if are_separate(*sides):
        found = compare_separate_runs(*sides, alpha=alpha, margin=margin, only=only, tasks=tasks)
        return ComparedSeparately(**vars(found))
    if tasks:
        raise RunError(f"{runs[0].folder}: expected no other names of tasks, its episodes are paired by their own")
    margin = defaults.margin if margin is None else margin
    return ComparedRuns(**vars(compare_runs(*sides, alpha=alpha, margin=margin, only=only, allowed=allowed)))


def _apart(opened: Sequence[OpenRun], runs: Sequence[Run]) -> tuple[Run, Run]:
    """Two runs, with their whole paths as names if they are of different folders of one name."""
    first, second = runs
    if first.name == second.name and opened[0].folder.resolve() != opened[1].folder.resolve():
        return replace(first, name=str(opened[0].folder)), replace(second, name=str(opened[1].folder))
    return first, second
