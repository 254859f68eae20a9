"""A section is one file: it reads columns, builds data and returns blocks, which every file of a report shows."""

import json
from dataclasses import dataclass

import pytest

from robogauntlet.results.report import section, summary, write_report
from robogauntlet.results.report.blocks import Fold, Heading, Paragraph, Sentences, Table, Terms
from robogauntlet.results.report.formatting import TextTable
from robogauntlet.results.report.markdown import render_blocks
from robogauntlet.results.report.section import Section
from tests.results.synthetic import cells, document, rows, run_folder


@dataclass(frozen=True)
class Steps:
    """Data of a section of another distribution."""

    longest: int


def steps_section(columns=("steps",)):
    return Section(
        name="steps",
        title="How long it takes",
        columns=columns,
        build=lambda source: Steps(int(source.rows["steps"].max())),
        type=Steps,
        blocks=lambda found, page: [
            Terms({"longest": "The most control steps of an episode."}),
            Fold("Numbers", (Table(TextTable(("longest",), ((str(found.longest),),), 0), "Steps"),)),
        ],
    )


@pytest.fixture
def other_section(monkeypatch):
    """One that another distribution declares by an entry point."""

    class Declared:
        name = "steps"

        def load(self):
            return steps_section()

    monkeypatch.setattr(section, "entry_points", lambda group: [Declared()] if group == section.GROUP else [])
    caches = (section.load_sections, summary.summary_model)
    for one in caches:
        one.cache_clear()
    yield
    for one in caches:
        one.cache_clear()


def test_a_section_of_another_distribution_is_in_every_file(other_section, tmp_path):
    plan = cells(("a",))
    paths = write_report(run_folder(tmp_path / "run", document(3, plan), rows(plan, 3))).paths
    page, text = paths.html.read_text(), paths.markdown.read_text()
    longest = max(one.steps for one in rows(plan, 3))
    assert json.loads(paths.summary.read_text())["steps"] == {"longest": longest}
    assert '<a href="#steps">How long it takes</a>' in page
    assert "<details" in page[page.index('id="steps"') :]
    assert f"## How long it takes\n\n### Numbers\n\n| longest |\n| ---: |\n| {longest} |" in text
    for shown in (page, text):
        assert shown.count("The most control steps of an episode.") == 1


def test_a_section_that_a_run_has_nothing_for_is_left_out(tmp_path):
    plan = cells(("a",))
    paths = write_report(run_folder(tmp_path / "run", document(3, plan), rows(plan, 3))).paths
    for shown in (paths.html.read_text(), paths.markdown.read_text()):
        assert "A against B" not in shown
        assert "How it fails" not in shown


def test_a_heading_with_nothing_below_it_is_left_out():
    blocks = [Heading("a"), Heading("b", level=4), Heading("c"), Paragraph("said"), Heading("d")]
    assert [*render_blocks(blocks)] == ["### c", "said"]


def test_texts_of_blocks_are_escaped():
    assert [*render_blocks([Sentences(("<b>*",)), Paragraph("a|b")])] == ["- &lt;b>\\*", "a\\|b"]
