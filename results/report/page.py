"""`report.html`: one file that opens anywhere, without a network and without JavaScript."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from results.merging import Merging
from results.record import Status
from results.report import facts, overall, text
from results.report import merging as words
from results.report import robustness as stress
from results.report import shift as against
from results.report.findings import findings
from results.report.media import Media, Video, task_picture
from results.report.summary import ERROR_GROUPS
from results.robustness import Robustness
from results.run import RunDocument
from results.tables import Aggregate, CellRow, Tables
from results.timing import PHASES
from suites.vocabulary import Condition

HERE = Path(__file__).parent
SERIES = 6
"""Colours and marker shapes before they repeat."""


@dataclass(frozen=True, slots=True)
class MatrixRow:
    """One policy under one condition: an aggregate per simulator, then over all."""

    total: Aggregate
    simulators: tuple[Aggregate | None, ...]


@dataclass(frozen=True, slots=True)
class ForestTask:
    """One task's cells under the condition shown."""

    task: str
    cells: tuple[CellRow, ...]


@dataclass(frozen=True, slots=True)
class CardLine:
    """One policy on a card of the gallery."""

    cell: CellRow
    videos: tuple[Video, ...]
    """A success, a failure, both or none."""


@dataclass(frozen=True, slots=True)
class Card:
    """One task of the gallery."""

    task: str
    instruction: str | None
    picture: str | None
    lines: tuple[CardLine, ...]


def render_page(
    folder: Path,
    document: RunDocument,
    tables: Tables,
    media: Media,
    merging: Merging | None = None,
    robustness: Robustness | None = None,
) -> str:
    """The whole page as HTML.

    Args:
        folder: The run folder, named in the commands that replay an episode.
        document: The run.
        tables: Its numbers.
        media: Videos and pictures.
        merging: What merging and routing cost, if the suite asks for it.
        robustness: How success falls with severity, if anything was perturbed.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(HERE), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    series = {policy: place % SERIES for place, policy in enumerate(tables.policies)}
    return environment.get_template("report.html.jinja").render(
        document=document,
        tables=tables,
        text=text,
        says=facts.SENTENCES,
        status=facts.status_word(document),
        verdict=facts.verdict(document, tables),
        provenance=facts.provenance(document, tables),
        gaps=facts.gaps(tables),
        skipped_episodes=facts.skipped_episodes(tables),
        error_groups=tables.errors[:ERROR_GROUPS],
        series=series,
        matrix=[row for row in _matrix(tables) if robustness is None or row.total.condition == _shown(tables)],
        several=len(tables.conditions) > 1,
        shown=_shown(tables),
        forest={simulator: _forest(tables, simulator) for simulator in tables.simulators},
        judged={cell.simulator for cell in tables.cells if cell.tally.verdicts and cell.condition == _shown(tables)},
        cards=_cards(folder, document, tables, media.typical),
        media=media,
        phases=PHASES,
        merging=merging,
        words=words,
        robustness=robustness,
        stress=stress,
        against=against,
        overall=overall,
        findings=findings(robustness) if robustness else (),
        shift_terms=list(facts.SHIFT_TERMS),
        robustness_terms=list(facts.ROBUSTNESS_TERMS),
        merging_terms=list(facts.MERGING_TERMS),
        router_terms=list(facts.ROUTER_TERMS),
        run=shlex.quote(str(folder)),
        style=(HERE / "report.css").read_text(encoding="utf-8"),
    )


def _shown(tables: Tables) -> Condition:
    """The condition of the forest and the gallery: clean, or the first that was planned."""
    return tables.conditions[0] if tables.conditions else Condition()


def _matrix(tables: Tables) -> list[MatrixRow]:
    return [
        MatrixRow(
            total,
            tuple(
                text.aggregate_of(tables, total.policy, simulator, total.axis, total.severity)
                for simulator in tables.simulators
            ),
        )
        for total in tables.by_policy
    ]


def _forest(tables: Tables, simulator: str) -> list[ForestTask]:
    shown = _shown(tables)
    tasks: dict[str, list[CellRow]] = {}
    for cell in tables.cells:
        if cell.simulator == simulator and cell.condition == shown:
            tasks.setdefault(cell.task, []).append(cell)
    return [ForestTask(task, tuple(cells)) for task, cells in tasks.items()]


def _cards(folder: Path, document: RunDocument, tables: Tables, videos: Sequence[Video]) -> list[Card]:
    filmed: dict[tuple[str, str], list[Video]] = {}
    for video in sorted(videos, key=lambda video: video.status != Status.SUCCESS):
        filmed.setdefault((video.policy_digest, video.task), []).append(video)
    cards = []
    for simulator in tables.simulators:
        for row in _forest(tables, simulator):
            picture = task_picture(folder, row.task)
            lines = tuple(CardLine(c, tuple(filmed.get((c.policy_digest, c.task), ()))) for c in row.cells)
            if picture or any(line.videos for line in lines):
                cards.append(Card(row.task, document.instructions.get(row.task), picture, lines))
    return cards
