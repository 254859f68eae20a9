"""`robogauntlet leaderboard`: rank the policies of a suite."""

from __future__ import annotations

from typing import Annotated

import typer

from robogauntlet.orchestrator.cli.common import AsJson, HistoryUrl, fail, open_history, out, print_json, print_line
from robogauntlet.orchestrator.cli.console_tables import rich_table
from robogauntlet.results.analysis import leaderboard as analysis
from robogauntlet.results.newest_results import latest_results_per_policy
from robogauntlet.results.report.history_plot import leaderboard_table
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.support.errors import BadInput


def leaderboard(
    suite: Annotated[str, typer.Argument(help="Name of a suite that was run.")],
    alpha: Annotated[float, typer.Option(min=0.0001, max=0.4999, help="Family-wise error rate.")] = 0.05,
    imported: Annotated[bool, typer.Option("--imported", help="Rank runs of others, too; they are marked.")] = False,
    as_json: AsJson = False,
    url: HistoryUrl = None,
) -> None:
    """Compare the policies of a suite by their newest complete runs.

    Policies that share a letter do not differ significantly. Tasks that only some have played do not count.
    """
    with open_history(url) as history:
        if suite not in history.suites():
            raise BadInput(f"no run of a suite '{suite}'{did_you_mean(suite, history.suites())}")
        results = list(latest_results_per_policy(history, suite, fail, imported=imported))
    if not results:
        others = "" if imported else "; runs of others count with --imported"
        raise BadInput(f"expected a complete run of suite '{suite}', found none{others}")
    rows = analysis.leaderboard(results, alpha)
    if as_json:
        print_json(rows)
        return
    out.print(rich_table(leaderboard_table(rows), title=f"{suite}, clean episodes"))
    print_line(f"\nPolicies that share a letter do not differ significantly (McNemar, Holm, alpha {alpha:g}).")
