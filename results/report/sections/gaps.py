"""Episodes that are missing, and errors."""

from __future__ import annotations

import shlex
from collections.abc import Iterator

from robogauntlet.results.report import facts
from robogauntlet.results.report.blocks import Block, Errors, Paragraph, Sentences, Table, Terms
from robogauntlet.results.report.formatting import TextTable, count, counted
from robogauntlet.results.report.section import Page, Section
from robogauntlet.results.report.summary import ERROR_GROUPS


def _missing(_: None, page: Page) -> Iterator[Block]:
    tables = page.report.tables
    gaps = facts.gaps(tables)
    if not gaps and not tables.skipped:
        yield Paragraph("All planned episodes have a result.")
    if tables.skipped:
        episodes = facts.skipped_episodes(tables)
        yield Terms({"skipped": facts.DEFINITIONS["skipped"]})
        yield Sentences(
            tuple(
                f"{simulator} was skipped ({counted(episodes[simulator], 'episode')}): {reason}"
                for simulator, reason in tables.skipped
            )
        )
    if gaps:
        rows = tuple((g.task, g.policy, str(g.condition), g.reason, count(g.missing)) for g in gaps)
        header = ("task", "policy", "condition", "reason", "missing")
        yield Table(TextTable(header, rows, 4), "Cells with missing episodes")


def _errors(_: None, page: Page) -> Iterator[Block]:
    errors = page.report.tables.errors
    if not errors:
        return
    yield Paragraph("Grouped by message, the most frequent first. Each command replays an episode with the error.")
    yield Terms({"error": facts.DEFINITIONS["error"]})
    yield Errors(errors[:ERROR_GROUPS], shlex.quote(str(page.folder)))
    if (more := len(errors) - ERROR_GROUPS) > 0:
        yield Paragraph(f"{count(more)} more messages are in episodes.parquet.")


SECTIONS = (Section("gaps", "Missing episodes", _missing), Section("errors", "Errors", _errors))
