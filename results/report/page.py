"""`report.html`: one file that needs no network, and JavaScript only to sort and filter its tables."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from robogauntlet.results.analysis.tables import Aggregate, CellRow, Tables
from robogauntlet.results.analysis.timing import PHASES
from robogauntlet.results.record import Status
from robogauntlet.results.report import behaviour as behaviour_text
from robogauntlet.results.report import combinations as combinations_text
from robogauntlet.results.report import condition_comparison as condition_texts
from robogauntlet.results.report import facts, formatting
from robogauntlet.results.report import failures as failures_text
from robogauntlet.results.report import merging_cost as merging_text
from robogauntlet.results.report import pairwise as pairwise_text
from robogauntlet.results.report import robots as robots_text
from robogauntlet.results.report import robustness as robustness_text
from robogauntlet.results.report.media import Media, Video, task_picture
from robogauntlet.results.report.summary import ERROR_GROUPS, Report
from robogauntlet.results.report.templates import report_templates, table_script
from robogauntlet.results.run_document import RunDocument
from robogauntlet.suites.episode import Condition

FOLDER = Path(__file__).parent
SERIES = 6
"""Number of colours (variables --s0 to --s5 of report.css) and marker shapes."""


@dataclass(frozen=True, slots=True)
class MatrixRow:
    """One policy under one condition: an aggregate per simulator, then over all."""

    total: Aggregate
    simulators: tuple[Aggregate | None, ...]


@dataclass(frozen=True, slots=True)
class ForestTask:
    """Cells of one task under the shown condition."""

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


def render_page(folder: Path, report: Report, media: Media) -> str:
    """Return the page as HTML; its commands that replay an episode name the run folder."""
    document, tables = report.document, report.tables
    shown = _shown(tables)
    series = {policy: place % SERIES for place, policy in enumerate(tables.policies)}
    return (
        report_templates()
        .get_template("report.html.jinja")
        .render(
            document=document,
            tables=tables,
            text=formatting,
            definitions=facts.DEFINITIONS,
            status=facts.status_word(document),
            verdict=facts.verdict(document, tables),
            provenance=facts.provenance(document),
            gaps=facts.gaps(tables),
            skipped_episodes=facts.skipped_episodes(tables),
            error_groups=tables.errors[:ERROR_GROUPS],
            series=series,
            matrix=[row for row in _matrix(tables) if row.total.condition == shown],
            several=len(tables.conditions) > 1,
            shown=shown,
            forest={simulator: _forest(tables, simulator) for simulator in tables.simulators},
            simulators_with_results={c.simulator for c in tables.cells if c.tally.verdicts and c.condition == shown},
            cards=_cards(folder, document, tables, media.representative),
            media=media,
            phases=PHASES,
            pairwise=report.pairwise,
            pairwise_text=pairwise_text,
            merging=report.merging,
            merging_text=merging_text,
            robustness=report.robustness,
            robustness_text=robustness_text,
            condition_texts=condition_texts,
            combinations=report.combinations,
            combinations_text=combinations_text,
            combination_terms=list(facts.COMBINATION_TERMS),
            combination_failures=partial(combinations_text.videos_of, media.new_failures),
            failures=report.failures,
            failures_text=failures_text,
            behaviour=report.behaviour,
            behaviour_text=behaviour_text,
            behaviour_terms=list(facts.BEHAVIOUR_TERMS),
            robots=report.robots,
            robots_text=robots_text,
            findings=report.findings,
            shift_terms=list(facts.SHIFT_TERMS),
            robustness_terms=list(facts.ROBUSTNESS_TERMS),
            merging_terms=list(facts.MERGING_TERMS),
            router_terms=list(facts.ROUTER_TERMS),
            run=shlex.quote(str(folder)),
            style=(FOLDER / "report.css").read_text(encoding="utf-8"),
            script=table_script(),
        )
    )


def _shown(tables: Tables) -> Condition:
    """The condition of task plots and gallery: clean, or the first of the plan."""
    return tables.conditions[0] if tables.conditions else Condition()


def _matrix(tables: Tables) -> list[MatrixRow]:
    rows = []
    for total in tables.by_policy:
        key = total.axis, total.severity
        by_simulator = (formatting.aggregate_of(tables, total.policy, name, *key) for name in tables.simulators)
        rows.append(MatrixRow(total, tuple(by_simulator)))
    return rows


def _forest(tables: Tables, simulator: str) -> list[ForestTask]:
    shown = _shown(tables)
    tasks: dict[str, list[CellRow]] = {}
    for cell in tables.cells:
        if cell.simulator == simulator and cell.condition == shown:
            tasks.setdefault(cell.task, []).append(cell)
    return [ForestTask(task, tuple(cells)) for task, cells in tasks.items()]


def _cards(folder: Path, document: RunDocument, tables: Tables, videos: Sequence[Video]) -> list[Card]:
    recorded: dict[tuple[str, str], list[Video]] = {}
    for video in sorted(videos, key=lambda video: video.status != Status.SUCCESS):
        recorded.setdefault((video.policy_digest, video.task), []).append(video)
    cards = []
    for simulator in tables.simulators:
        for row in _forest(tables, simulator):
            picture = task_picture(folder, row.task)
            lines = tuple(CardLine(c, tuple(recorded.get((c.policy_digest, c.task), ()))) for c in row.cells)
            if picture or any(line.videos for line in lines):
                cards.append(Card(row.task, document.instructions.get(row.task), picture, lines))
    return cards
