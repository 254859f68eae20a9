"""What merging experts and inferring the task cost."""

from __future__ import annotations

from collections.abc import Iterator

from robogauntlet.results.analysis.merging_cost import COLUMNS, Merging, build_merging
from robogauntlet.results.analysis.routing import Calibration, Confusion
from robogauntlet.results.report import merging_cost as words
from robogauntlet.results.report.blocks import (
    Block,
    Charts,
    Heading,
    HeatCell,
    HeatMap,
    Line,
    LineChart,
    Paragraph,
    Point,
    Table,
    Terms,
)
from robogauntlet.results.report.facts import DEFINITIONS, MERGING_TERMS, ROUTER_TERMS
from robogauntlet.results.report.formatting import TextTable, count, counted, percent, share, short_task
from robogauntlet.results.report.section import Page, Section


def _blocks(found: Merging, page: Page) -> Iterator[Block]:
    where = f", under the condition {found.condition}" if len(page.report.tables.conditions) > 1 else ""
    yield Paragraph(
        "Success of the expert of each task, of the merged policy that is given the true task (oracle-routed), and of "
        f"merged policies that infer the task (routed){where}."
    )
    yield Terms({term: DEFINITIONS[term] for term in MERGING_TERMS})
    caption = "Success of expert, oracle-routed and routed policies, with router accuracy"
    yield Table(words.comparison_table(found), caption)
    if any(one.router for one in found.routed):
        yield Heading("Routers")
        yield Terms({term: DEFINITIONS[term] for term in ROUTER_TERMS})
        yield Table(words.router_table(found), "Router accuracy, calibration, latency and regret")
    for one in found.routed:
        yield Heading(f"{one.policy}: success lost", one.policy)
        yield Table(words.losses_table(one), f"{one.policy}: success lost by merging and by routing")
        if one.router is not None:
            yield _confusion(one.policy, one.router.confusion)
            if one.router.calibration is not None:
                yield Charts((_reliability(one.policy, one.router.calibration),))
        if bins := words.calibration_table(one):
            yield Paragraph("Accuracy by confidence:")
            yield Table(bins, f"{one.policy}: accuracy by confidence")


def _confusion(policy: str, found: Confusion) -> HeatMap:
    rows = []
    for task, counts in zip(found.true, found.counts, strict=True):
        total = sum(counts) or 1
        cells = tuple(_cell(task, *cell, total) for cell in zip(found.inferred, counts, strict=True))
        rows.append((short_task(task), cells))
    columns = tuple(map(short_task, found.inferred))
    title, label = "True task (rows) and inferred task (columns)", f"{policy}: true task and inferred task, episodes"
    return HeatMap(
        label,
        "true task",
        columns,
        tuple(rows),
        title=title,
        table=words.confusion_table(found),
        figure="confusion",
        about=policy,
        unit="episodes",
    )


def _cell(task: str, inferred: str, episodes: int, total: int) -> HeatCell:
    share, names = episodes / total, f"{short_task(task)} inferred as {short_task(inferred)}"
    title = f"{names}: {counted(episodes, 'episode')}, {percent(share)}"
    text, kind = count(episodes) if episodes else "", "right" if inferred == task else "wrong"
    return HeatCell(share, text, title=title, kind=kind)


def _reliability(policy: str, found: Calibration) -> LineChart:
    made = []
    for one in found.bins:
        if one.accuracy.rate is None:
            continue
        ends = one.accuracy.interval
        low, high = (None, None) if ends is None else (100 * ends.low, 100 * ends.high)
        text = f"confidence {one.confidence:.2f}, accuracy {share(one.accuracy)}, {counted(one.episodes, 'episode')}"
        made.append(Point(100 * one.confidence, 100 * one.accuracy.rate, low, high, text))
    label = f"{policy}: accuracy by the probability of the choice; calibration error {found.expected_error:.3f}"
    ticks = tuple((float(tick), str(tick)) for tick in (0, 25, 50, 75, 100))
    axes, lines = ("probability of the choice (%)", "accuracy (%)"), (Line(policy, tuple(made)),)
    return LineChart(f"{policy}: reliability", label, lines, ticks, *axes, True, "reliability", policy)


def _text_tables(found: Merging) -> Iterator[tuple[str, TextTable]]:
    for one in found.routed:
        sides = f"expert ({found.expert}), oracle-routed ({found.oracle_routed}), routed ({one.policy})"
        yield f"Success of {sides}; accuracy of the router", words.compact_table(one)
    yield "Success lost over all tasks, on the same episodes", words.overall_table(found)


SECTIONS = (
    Section(
        name="merging",
        title="Merging and routing",
        columns=COLUMNS,
        applies=lambda document: document.suite.merging is not None,
        build=lambda source: build_merging(source.document, source.rows),
        type=Merging,
        blocks=_blocks,
        text_tables=_text_tables,
    ),
)
