"""`report.html`: one file that needs no network, and JavaScript only to sort and filter its tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from markupsafe import Markup

from robogauntlet.results.report import facts, formatting
from robogauntlet.results.report.blocks import Block, Fold, Terms
from robogauntlet.results.report.section import Report, Section
from robogauntlet.results.report.templates import report_templates, table_script

FOLDER = Path(__file__).parent
SERIES = 6
"""Number of colours (variables --s0 to --s5 of report.css) and marker shapes."""


@dataclass(frozen=True, slots=True)
class Chapter:
    """A section with what it shows."""

    section: Section
    blocks: tuple[Block, ...]
    links: tuple[tuple[str, str], ...]
    """Anchors and texts of its links in the list of contents."""


def terms_of(blocks: Iterable[Block]) -> dict[str, str]:
    """The terms that blocks use, with their definitions, in the order of their first use."""
    found: dict[str, str] = {}
    for block in blocks:
        inner = block.definitions if isinstance(block, Terms) else {}
        found |= terms_of(block.blocks) if isinstance(block, Fold) else inner
    return found


def render_blocks(blocks: Iterable[Block], policies: Sequence[str] = (), shown: set[str] | None = None) -> Markup:
    """Return blocks as HTML; the place of a policy among `policies` says its colour and marker.

    `shown` has the episodes whose video the page has already, and gets those of these blocks.
    """
    known = set() if shown is None else shown

    def is_first(episode_id: str) -> bool:
        was_known = episode_id in known
        known.add(episode_id)
        return not was_known

    series = {policy: place % SERIES for place, policy in enumerate(policies)}

    def draw(block: Block) -> Markup:
        return Markup(getattr(macros, type(block).__name__.lower())(block))

    variables: dict[str, Any] = {"draw": draw, "series": series, "text": formatting, "is_first": is_first}
    macros = report_templates().get_template("blocks.html.jinja").make_module(variables)
    return Markup("").join(map(draw, blocks))


def render_page(report: Report, chapters: Sequence[Chapter]) -> str:
    """Return the page as HTML."""
    document, policies, shown = report.document, report.tables.policies, set[str]()
    return (
        report_templates()
        .get_template("report.html.jinja")
        .render(
            document=document,
            status=facts.status_word(document),
            verdict=facts.verdict(document, report.tables),
            is_empty=not report.tables.total.done,
            chapters=[(chapter, render_blocks(chapter.blocks, policies, shown)) for chapter in chapters],
            terms=terms_of(block for chapter in chapters for block in chapter.blocks),
            style=(FOLDER / "report.css").read_text(encoding="utf-8"),
            script=table_script(),
        )
    )
