"""Software, hardware and settings of a run."""

from __future__ import annotations

from collections.abc import Iterator

from robogauntlet.results.report import facts
from robogauntlet.results.report.blocks import Block, Code, Facts, Heading, Paragraph
from robogauntlet.results.report.formatting import count
from robogauntlet.results.report.section import Page, Section


def _blocks(_: None, page: Page) -> Iterator[Block]:
    document, tables = page.report.document, page.report.tables
    yield Paragraph("Software, hardware and settings needed to reproduce these results.")
    speed = ("episodes per hour", count(tables.episodes_per_hour))
    yield Facts((*facts.provenance(document), speed))
    if document.provenance.versions:
        yield Heading("Packages")
        yield Facts(tuple(sorted(document.provenance.versions.items())), ("package", "version"), are_short=True)
    yield Heading("Suite file")
    yield Code(document.suite_text)


SECTIONS = (Section("provenance", "Provenance", _blocks),)
