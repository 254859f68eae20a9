"""What the time of the workers went into."""

from __future__ import annotations

from collections.abc import Iterator

from robogauntlet.results.analysis.timing import PHASES, PhaseTiming
from robogauntlet.results.report.blocks import Bar, Block, Legend, Paragraph, Segment, StackedBars, Table, Terms
from robogauntlet.results.report.facts import DEFINITIONS
from robogauntlet.results.report.formatting import percent, seconds, timing_table
from robogauntlet.results.report.section import Page, Section


def _blocks(_: None, page: Page) -> Iterator[Block]:
    timing = page.report.tables.timing
    if not any(line.total_s > 0 for line in timing):
        yield Paragraph("No times were measured.")
        return
    yield Terms({term: DEFINITIONS[term] for term in (*PHASES, "busy")})
    yield Legend(tuple(PHASES), "phase")
    yield StackedBars("phase", tuple(_bar(line) for line in timing if line.total_s > 0), "worker-time")
    yield Table(timing_table(timing), "Worker time per simulator and phase")


def _bar(line: PhaseTiming) -> Bar:
    parts, start = [], 0.0
    for phase in PHASES:
        spent = line.seconds(phase)
        if spent > 0:
            width = 100 * spent / line.total_s
            text = f"{phase}: {seconds(spent)}, {percent(spent / line.total_s)}"
            parts.append(Segment(phase, round(start, 3), round(width, 3), text))
            start += width
    label = f"{line.simulator}: share of worker time per phase"
    return Bar(line.simulator, seconds(line.total_s), tuple(parts), label)


SECTIONS = (Section("time", "Worker time", _blocks),)
