"""What merging experts and inferring the task cost, as a section of the report."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from robogauntlet.results.analysis.routing import Rate, Router
from robogauntlet.results.report.blocks import Block, Heading, Paragraph, Table, Terms
from robogauntlet.results.report.formatting import NOTHING, TextTable, count, counted, percent, points, rate, share
from robogauntlet.results.report.section import Page, Report, Section
from robogauntlet_mergevla.report.losses import (
    COLUMNS,
    Losses,
    Merging,
    MergingRow,
    RoutedComparison,
    build_merging,
)

TERMS = {
    "expert": "The policy fine-tuned on the task, before merging.",
    "oracle-routed": "The merged policy, given the true task.",
    "routed": "The merged policy, which infers the task from the first observation.",
    "loss": "Difference of success rates in percentage points, with Newcombe's paired interval (95 %). By merging: "
    "expert minus oracle-routed. By routing: oracle-routed minus routed. Both: their sum.",
    "pairs": "Task and seed combinations in which all three policies succeeded or failed. Pairs with an error or a "
    "missing episode are excluded from losses and counted as left out.",
    "retention": "Successes of the routed policy per success of the expert, over all tasks together, with Tang's score "
    "interval (95 %), which excludes 100 % only if McNemar's exact test shows a loss or gain.",
    "regret": "Oracle-routed minus routed success on the misrouted pairs, in percentage points.",
}
ALL = "all"


def label(row: MergingRow) -> str:
    """The task, simulator or `all` of a row."""
    return row.task or (f"{row.simulator}, {ALL}" if row.simulator else ALL)


def comparison_table(merging: Merging, routers: Mapping[str, Router]) -> TextTable:
    """Success of expert, oracle-routed and each routed policy, and router accuracy, by task and simulator."""
    header = ["task", f"expert ({merging.expert})", f"oracle-routed ({merging.oracle_routed})"]
    for comparison in merging.routed:
        header += [f"routed ({comparison.policy})", "router accuracy"]
    lines = []
    for place, row in enumerate(_lines(merging.routed[0])):
        cells = [label(row), share(row.expert), share(row.oracle_routed)]
        for comparison in merging.routed:
            routed = _lines(comparison)[place]
            cells += [share(routed.routed), share(accuracy(routers.get(comparison.policy), routed))]
        lines.append(tuple(cells))
    return TextTable(tuple(header), tuple(lines), 1)


def compact_table(comparison: RoutedComparison, router: Router | None) -> TextTable:
    """The same of one routed policy for a terminal: rates without intervals, and numbers of episodes."""
    lines = []
    for row in _lines(comparison):
        rates = (row.expert, row.oracle_routed, row.routed, accuracy(router, row))
        trials = sorted({found.trials for found in rates if found is not None and found.trials})
        shown = (NOTHING if found is None else percent(found.rate) for found in rates)
        lines.append((label(row), *shown, "/".join(map(str, trials)) or NOTHING))
    return TextTable(("task", "expert", "oracle-routed", "routed", "accuracy", "n"), tuple(lines), 1)


def overall_table(merging: Merging) -> TextTable:
    """Success lost over all tasks, with a column per routed policy."""
    names = ("loss by merging", "loss by routing", "both", "retention", "pairs", "left out")
    columns = [_losses(comparison.overall)[1:] for comparison in merging.routed]
    header = ("percentage points", *(comparison.policy for comparison in merging.routed))
    return TextTable(header, tuple((name, *values) for name, *values in zip(names, *columns, strict=True)), 1)


def losses_table(comparison: RoutedComparison) -> TextTable:
    """Success lost by merging, by routing and in total, by task and simulator."""
    header = ("", "loss by merging", "loss by routing", "both", "retention", "pairs", "left out")
    return TextTable(header, tuple(_losses(row) for row in _lines(comparison)), 1)


def _losses(row: MergingRow) -> tuple[str, ...]:
    losses = row.losses
    parts = (points(losses.merging), points(losses.routing), points(losses.total), rate(losses.retention))
    return (label(row), *parts, count(losses.pairs), left_out(losses))


def left_out(losses: Losses) -> str:
    """Number of pairs left out by reason: `2 errors, 1 missing`."""
    parts = [counted(losses.errors, "error") if losses.errors else ""]
    parts.append(f"{losses.missing:,} missing" if losses.missing else "")
    return ", ".join(filter(None, parts)) or "0"


def regret_table(merging: Merging) -> TextTable:
    """Pairs on which each routed policy inferred a wrong task, and the success lost on them."""
    lines = tuple((one.policy, count(one.regret.misrouted), points(one.regret.lost)) for one in merging.routed)
    return TextTable(("policy", "misrouted pairs", "regret on them"), lines, 1)


def accuracy(router: Router | None, row: MergingRow) -> Rate | None:
    """The router accuracy on the tasks of a row."""
    if router is None:
        return None
    if row.task is not None:
        return dict(router.tasks).get(row.task)
    return router.accuracy if row.simulator is None else dict(router.simulators).get(row.simulator)


def _lines(comparison: RoutedComparison) -> tuple[MergingRow, ...]:
    return (*comparison.tasks, *comparison.simulators, comparison.overall)


def _routers(report: Report) -> dict[str, Router]:
    return {one.policy: one.router for one in report.data.get("routing", ())}


def _blocks(found: Merging, page: Page) -> Iterator[Block]:
    where = f", under the condition {found.condition}" if len(page.report.tables.conditions) > 1 else ""
    yield Paragraph(
        "Success of the expert of each task, of the merged policy that is given the true task (oracle-routed), and of "
        f"merged policies that infer the task (routed){where}."
    )
    yield Terms(TERMS)
    caption = "Success of expert, oracle-routed and routed policies, with router accuracy"
    yield Table(comparison_table(found, _routers(page.report)), caption)
    for one in found.routed:
        yield Heading(f"{one.policy}: success lost", one.policy)
        yield Table(losses_table(one), f"{one.policy}: success lost by merging and by routing")
    if any(one.regret.misrouted for one in found.routed):
        yield Heading("Regret")
        yield Table(regret_table(found), "Success lost by misrouting")


def _text_tables(found: Merging, report: Report) -> Iterator[tuple[str, TextTable]]:
    routers = _routers(report)
    for one in found.routed:
        sides = f"expert ({found.expert}), oracle-routed ({found.oracle_routed}), routed ({one.policy})"
        yield f"Success of {sides}; accuracy of the router", compact_table(one, routers.get(one.policy))
    yield "Success lost over all tasks, on the same episodes", overall_table(found)


SECTION = Section(
    name="merging",
    title="Merging and routing",
    columns=COLUMNS,
    applies=lambda document: document.suite.merging is not None,
    build=lambda source: build_merging(source.document, source.rows),
    type=Merging,
    blocks=_blocks,
    text_tables=_text_tables,
)
