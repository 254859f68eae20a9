"""`report.md`: the report as GitHub Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from robogauntlet.results.report import facts
from robogauntlet.results.report.blocks import (
    Block,
    Charts,
    Errors,
    Facts,
    Fold,
    Heading,
    HeatMap,
    Paragraph,
    RatePlot,
    Rates,
    Sentences,
    Table,
)
from robogauntlet.results.report.formatting import TextTable, count, escape, markdown
from robogauntlet.results.report.page import Chapter, terms_of
from robogauntlet.results.report.section import Report


def render_markdown(report: Report, chapters: Sequence[Chapter]) -> str:
    """Return the report as GitHub Markdown."""
    document = report.document
    verdict = escape(facts.verdict(document, report.tables))
    parts = [f"# {escape(document.suite.name)}", f"**{facts.status_word(document)}**: {verdict}"]
    parts += [f"**Warning**: {escape(warning)}." for warning in document.warnings]
    if document.suite.description:
        parts.append(escape(document.suite.description))
    if not report.tables.total.done:
        parts.append("**This run has no results yet.**")
    for chapter in chapters:
        shown = [*render_blocks(chapter.blocks)]
        parts += [f"## {chapter.section.title}", *shown] if shown else []
    terms = terms_of(block for chapter in chapters for block in chapter.blocks)
    parts += ["## Terms", "\n".join(f"- {term}: {escape(definition)}" for term, definition in terms.items())]
    return "\n\n".join(parts) + "\n"


def render_blocks(blocks: Iterable[Block]) -> Iterator[str]:
    """Yield the paragraphs, lists and tables of blocks; a heading with nothing below it is left out."""
    pending: list[tuple[int, str]] = []
    for block in blocks:
        if isinstance(block, Heading):
            pending = [one for one in pending if one[0] < block.level]
            pending.append((block.level, f"{'#' * block.level} {escape(block.text)}"))
            continue
        for part in _parts(block):
            yield from (heading for _, heading in pending)
            pending = []
            yield part


def _parts(block: Block) -> Iterator[str]:
    match block:
        case Paragraph(is_of_plot=False):
            yield escape(block.text)
        case Sentences(items):
            yield "\n".join(f"- {escape(sentence)}" for sentence in items)
        case Table(content):
            yield markdown(content)
        case Facts(items, names):
            yield markdown(TextTable(names, items, 2))
        case Fold():
            inner = [*render_blocks(block.blocks)]
            title = f"### {escape(block.summary)}" if block.title is None else escape(block.title)
            yield from [title, *inner] if inner and title else inner
        case Charts(items):
            for item in items:
                yield from _parts(item)
        case Rates(table=TextTable() as table) | RatePlot(table=TextTable() as table):
            yield markdown(table)
        case HeatMap(table=TextTable() as table):
            yield from [f"{escape(block.title)}:"] if block.title else []
            yield markdown(table)
        case Errors(groups):
            rows = [(g.message, ", ".join(g.tasks), ", ".join(g.examples), count(g.count)) for g in groups]
            yield markdown(TextTable(("message", "tasks", "episodes", "count"), tuple(rows), 3))
