"""Numbers of episodes by task, policy and condition."""

from __future__ import annotations

from collections.abc import Iterator

from robogauntlet.results.report.blocks import Block, Heading, Table, Terms
from robogauntlet.results.report.facts import DEFINITIONS
from robogauntlet.results.report.formatting import task_table
from robogauntlet.results.report.section import Page, Section


def _blocks(_: None, page: Page) -> Iterator[Block]:
    tables = page.report.tables
    yield Terms({term: DEFINITIONS[term] for term in ("done", "error", "bounds")})
    for simulator in tables.simulators:
        yield Heading(simulator)
        yield Table(task_table(tables, simulator), f"{simulator}: episodes and rates per task")


SECTIONS = (Section("counts", "Counts", _blocks),)
