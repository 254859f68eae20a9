"""Combinations of axes as sentences, tables and in the files of a report."""

import json

import pytest

from robogauntlet.results.analysis import combinations as analysis
from robogauntlet.results.report import summary_model, write_report
from robogauntlet.results.report.sections import combinations
from tests import ROOT
from tests.results.analysis.test_combinations import (
    SOBOL,
    SPREAD,
    fails_in_the_dark_on_another_table,
    played,
    severities,
)
from tests.results.synthetic import columns_of, run_folder

KEPT = ROOT / "docs/reports"


def found(design=SPREAD, succeeds=fails_in_the_dark_on_another_table):
    run, rows = played(design, succeeds, tasks=("maniskill/A",))
    return analysis.build_combinations(run, columns_of(rows, analysis.COLUMNS))


def test_three_sentences_say_when_why_and_how_sure():
    built = found()
    when, why, sure = combinations.sentences(built.policies[0], built.axes)
    assert when.startswith("a in maniskill succeeds in ")
    assert "where table is 3 or more (35 dE*ab of the mean colour) and illuminance is 2 or more (1 EV darker), " in when
    assert why == "Why: unknown, indices need a suite with design: {kind: sobol}."
    assert "1 failure cluster found on one half of the seeds and confirmed on the other (p <0.001" in sure
    assert sure.endswith("800 episodes at 200 points.")


def test_indices_are_named_largest_first():
    built = found(SOBOL, lambda cell, seed: severities(cell.condition).get("table", 0) < 2.5)
    _, why, sure = combinations.sentences(built.policies[0], built.axes)
    assert why.startswith(
        "Why: of the differences in success that the axes cause, with their interactions, table 100 %"
    )
    assert "the axes explain 100 %" in sure
    assert combinations.index_table(built.policies[0]).rows[0][0] == "table"


def test_an_axis_is_not_said_to_matter_most_where_intervals_overlap():
    unsure = "which axis matters most is not shown"
    for bounds, said in (({"table": 2.5}, False), ({"table": 2.5, "illuminance": 2.5}, True)):
        built = found(SOBOL, lambda cell, seed, b=bounds: all(severities(cell.condition).get(a, 0) < b[a] for a in b))
        assert (unsure in combinations.sentences(built.policies[0], built.axes)[2]) == said


def test_without_failures_nothing_is_claimed():
    built = found(SOBOL, lambda cell, seed: True)
    when, why, _ = combinations.sentences(built.policies[0], built.axes)
    assert when.endswith("no combination was shown to fail more often than the rest.")
    assert why == "Why: unknown, success is not shown to depend on the axes."


@pytest.mark.parametrize("design", [SPREAD, SOBOL], ids=["latin-hypercube", "sobol"])
def test_the_files_of_a_report_have_the_section_first(tmp_path, design):
    run, rows = played(design, fails_in_the_dark_on_another_table)
    folder = run_folder(tmp_path / "run", run, rows)
    report = write_report(folder)
    page, text = report.paths.html.read_text(), report.paths.markdown.read_text()
    assert page.index('id="combinations"') < page.index('id="rates"')
    assert "table is 3 or more" in page
    assert "## Why it fails" in text
    summary = summary_model().model_validate_json(report.paths.summary.read_text())
    assert [one.simulator for one in summary.combinations.policies] == ["maniskill", "robosuite"]
    assert json.loads(report.paths.summary.read_text())["combinations"]["axes"] == design["axes"]
