"""Policies compared with each other, episode by episode."""

from __future__ import annotations

from collections.abc import Iterator

from robogauntlet.results.analysis.comparison import PolicyComparison, Run
from robogauntlet.results.analysis.pairwise import COLUMNS, PolicyComparisons, compare_all
from robogauntlet.results.report import pairwise as words, unpaired
from robogauntlet.results.report.blocks import Block, Fold, Heading, Paragraph, Sentences, Table, Terms
from robogauntlet.results.report.section import Section, Source
from robogauntlet.results.run_document import RunDocument


def _has_several_policies(document: RunDocument) -> bool:
    return len({cell.policy for cell in document.plan}) > 1


def _build(source: Source) -> PolicyComparisons | None:
    if not source.tables.total.done or not _has_several_policies(source.document):
        return None
    return compare_all(Run(source.folder.absolute().name, source.document, source.rows))


def comparison_blocks(found: PolicyComparisons) -> Iterator[Block]:
    """The comparisons, of a run or of several."""
    if standings := words.standings_table(found):
        yield Table(standings, "Policies with letters")
    for sentence in words.summary(found):
        yield Paragraph(sentence)
    if len(found.comparisons) == 1:
        yield Heading(words.headline(found.comparisons[0]))
        yield from _of_one(found.comparisons[0], found)
    elif found.comparisons:
        yield words.overview_forest(found)
        yield Table(words.overview_table(found), "Comparisons over all tasks")
        for one in found.comparisons:
            yield Fold(words.headline(one), tuple(_of_one(one, found)))
    for apart in found.unpaired:
        yield Heading(words.headline(apart))
        yield Sentences(tuple(words.sentences(apart, found)))
        yield Table(words.table(apart), f"{words.title(apart)}, task by task")
    if found.unpaired:
        yield Paragraph(unpaired.METHOD)
    yield Terms(dict(words.terms(found)))


def _of_one(one: PolicyComparison, found: PolicyComparisons) -> Iterator[Block]:
    title = words.title(one)
    yield Sentences(tuple(words.sentences(one, found)))
    yield words.task_forest(one, found)
    yield Table(words.table(one), f"{title}, task by task")
    if perturbed := words.condition_table(one):
        yield Paragraph("Under perturbations, all tasks together:")
        yield Table(perturbed, f"{title}, condition by condition")
    for name, table in words.behaviour_tables(one):
        yield Paragraph(f"{name}:")
        yield Table(table, f"{title}: {name}")


SECTIONS = (
    Section(
        name="pairwise",
        title="A against B",
        columns=COLUMNS,
        applies=_has_several_policies,
        build=_build,
        type=PolicyComparisons,
        blocks=lambda found, page: comparison_blocks(found),
    ),
)
