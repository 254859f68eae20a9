"""Success against the time that answers take, by what the robot does meanwhile."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import pandas as pd

from robogauntlet.results.analysis.robustness import PolicyCurve, Robustness
from robogauntlet.results.record import WAITING
from robogauntlet.results.report.blocks import (
    Block,
    Charts,
    Legend,
    Line,
    LineChart,
    Paragraph,
    Point,
    Sentences,
    Table,
)
from robogauntlet.results.report.formatting import NOTHING, TextTable, percent, rate
from robogauntlet.results.report.section import Page, Report, Section, Source
from robogauntlet.results.run_document import RunDocument
from robogauntlet.results.statistics.pairs import MARGIN
from robogauntlet.results.statistics.rates import Estimate
from robogauntlet.suites.axes import AXES, LATENCY
from robogauntlet.suites.episode import Condition

COLUMNS = ("policy", "axis", "severity", "steps", *WAITING)
"""Fields of the record that are needed."""
DOING = {"hold": "holds", "continue": "continues", "blend": "blends"}


@dataclass(frozen=True, slots=True)
class LatencyCurve:
    """Success of a policy by the additional latency of its answers, in one simulator or all."""

    policy: str
    simulator: str | None
    mode: str
    """What the robot does meanwhile: a `TimingMode`."""
    latencies_ms: tuple[float, ...]
    """From 0."""
    rates: tuple[Estimate, ...]
    kept_ms: float
    """Latency up to which less than `MARGIN` is shown to be lost, at this level and all below it."""
    lost_ms: float | None
    """Lowest latency at which a loss is shown; None if there is none."""


@dataclass(frozen=True, slots=True)
class Waiting:
    """What the robot did while a policy's answers took time, on average over steps or episodes."""

    policy: str
    condition: str
    held: float
    """Share of the steps in which it held."""
    stale: float
    """Share of the steps in which it executed the answer before."""
    age_ms: float
    """Age of the observation behind an executed action."""
    chunk_share: float
    """Share of the answered actions that were executed."""


@dataclass(frozen=True, slots=True)
class Latency:
    """All that a run shows about latency."""

    timing: str | None
    """The suite's own timing."""
    curves: tuple[LatencyCurve, ...]
    waiting: tuple[Waiting, ...]


def build_latency(source: Source) -> Latency | None:
    """The curves of the axes of latency, and what waiting did; None if no episode had to wait."""
    rows = source.rows[source.rows["held_steps"].notna()]
    if rows.empty:
        return None
    robustness: Robustness | None = source.data.get("robustness")
    curves = () if robustness is None else robustness.curves
    timing = source.document.suite.timing
    found = tuple(_curve(one) for one in curves if one.axis in LATENCY)
    return Latency(None if timing is None else str(timing), found, tuple(_waiting(rows)))


def _curve(found: PolicyCurve) -> LatencyCurve:
    axis, curve = AXES[found.axis], found.curve
    latencies = tuple(axis.value(level) if level else 0.0 for level in curve.levels)
    kept, lost = 0.0, None
    for latency, drop in zip(latencies[1:], curve.drops[1:], strict=True):
        if drop.interval is None or drop.interval.high >= MARGIN:
            break
        kept = latency
    for latency, drop in zip(latencies[1:], curve.drops[1:], strict=True):
        if lost is None and drop.interval is not None and drop.interval.low > 0:
            lost = latency
    return LatencyCurve(found.policy, found.simulator, str(LATENCY[found.axis]), latencies, curve.rates, kept, lost)


def _waiting(rows: pd.DataFrame) -> Iterator[Waiting]:
    for (policy, axis, severity), own in rows.groupby(["policy", "axis", "severity"], observed=True, sort=False):
        steps = own["steps"].sum()
        yield Waiting(
            str(policy),
            str(Condition(str(axis), int(severity))),
            float(own["held_steps"].sum() / steps),
            float(own["stale_steps"].sum() / steps),
            float(1000 * own["observation_age"].mean()),
            float(own["chunk_share"].mean()),
        )


def curve_table(found: Sequence[LatencyCurve]) -> TextTable:
    """Success at each latency, and up to which it is kept."""
    latencies = sorted({latency for one in found for latency in one.latencies_ms})
    header = ("policy", "simulator", "robot", *(f"{latency:g} ms" for latency in latencies))
    lines = []
    for one in found:
        rates = dict(zip(one.latencies_ms, one.rates, strict=True))
        lost = NOTHING if one.lost_ms is None else f"{one.lost_ms:g} ms"
        cells = (rate(rates.get(latency)) for latency in latencies)
        lines.append((one.policy, one.simulator or "all", DOING[one.mode], *cells, f"{one.kept_ms:g} ms", lost))
    return TextTable((*header, "kept to", "loss shown from"), tuple(lines), 3)


def waiting_table(found: Sequence[Waiting]) -> TextTable:
    """What the robot did while answers took time."""
    header = ("policy", "condition", "steps held", "steps of the last answer", "observation age (ms)", "chunk executed")
    lines = (
        (
            one.policy,
            one.condition,
            percent(one.held),
            percent(one.stale),
            f"{one.age_ms:.0f}",
            percent(one.chunk_share),
        )
        for one in found
    )
    return TextTable(header, tuple(lines), 2)


def sentences(found: Latency) -> Iterator[str]:
    """Up to which latency each policy keeps its success, over all simulators."""
    several = any(one.simulator is None for one in found.curves)
    for one in found.curves:
        if several and one.simulator is not None:
            continue
        kept = f"keeps its success (loses less than {100 * MARGIN:.0f} points) up to {one.kept_ms:g} ms"
        if not one.kept_ms:
            kept = f"is not shown to keep its success at {one.latencies_ms[1]:g} ms"
        lost = "no loss is shown" if one.lost_ms is None else f"a loss is shown from {one.lost_ms:g} ms"
        yield f"{one.policy}, robot {DOING[one.mode]}: {kept}; {lost}."


def _blocks(found: Latency, page: Page) -> Iterator[Block]:
    if found.timing is not None:
        yield Paragraph(f"Answers take time in all episodes of this run: {found.timing}.")
    modes = tuple(dict.fromkeys(one.mode for one in found.curves))
    if modes:
        yield Sentences(tuple(sentences(found)))
        yield Legend(tuple(dict.fromkeys(one.policy for one in found.curves)))
        yield Charts(tuple(_chart(mode, found.curves) for mode in modes))
        yield Table(curve_table(found.curves), "Success by the latency of answers")
    yield Table(waiting_table(found.waiting), "What the robot did while answers took time")


def _chart(mode: str, curves: Sequence[LatencyCurve]) -> LineChart:
    """Overall curves of a mode."""
    first: dict[str, LatencyCurve] = {}
    for one in curves:
        if one.mode == mode:
            first.setdefault(one.policy, one)
    last = max(one.latencies_ms[-1] for one in first.values())
    ticks = tuple((25.0 * quarter, f"{last * quarter / 4:g}") for quarter in range(5))
    lines = tuple(Line(one.policy, tuple(_points(one, last))) for one in first.values())
    title = f"robot {DOING[mode]}"
    return LineChart(
        title, f"{title}: success by latency", lines, ticks, "latency (ms)", "success (%)", figure="success-by-latency"
    )


def _points(one: LatencyCurve, last: float) -> Iterator[Point]:
    for latency, estimate in zip(one.latencies_ms, one.rates, strict=True):
        ends = estimate.interval
        low, high = (None, None) if ends is None else (100 * ends.low, 100 * ends.high)
        text = f"{one.policy}, {latency:g} ms: {rate(estimate)}"
        yield Point(100 * latency / last, 100 * estimate.value, low, high, text)


def _applies(document: RunDocument) -> bool:
    return document.suite.timing is not None or any(
        part.axis in LATENCY for cell in document.plan for part in cell.condition.perturbations
    )


def _text_tables(found: Latency, report: Report) -> Iterator[tuple[str, TextTable]]:
    if found.curves:
        yield "Success by the latency of answers", curve_table(found.curves)


SECTIONS = (
    Section(
        name="latency",
        title="Latency",
        columns=COLUMNS,
        build=build_latency,
        applies=_applies,
        type=Latency,
        blocks=_blocks,
        sentences=sentences,
        text_tables=_text_tables,
    ),
)
