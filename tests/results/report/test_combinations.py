"""Combinations of axes as sentences, tables and in the files of a report."""

import json
from dataclasses import replace

import pytest

from robogauntlet.results.analysis import combinations as analysis
from robogauntlet.results.report import summary_model, write_report
from robogauntlet.results.report.sections import combinations
from robogauntlet.results.statistics.sensitivity import Sensitivity
from tests.results.analysis.test_combinations import (
    SOBOL,
    SPREAD,
    chance,
    fails_in_the_dark_on_another_table,
    played,
    severities,
)
from tests.results.synthetic import columns_of, run_folder


def found(design=SPREAD, succeeds=fails_in_the_dark_on_another_table):
    run, rows = played(design, succeeds, tasks=("maniskill/A",))
    return analysis.build_combinations(run, columns_of(rows, analysis.COLUMNS))


def test_three_sentences_say_when_why_and_how_sure():
    built = found()
    when, why, sure = combinations.sentences(built.policies[0], built)
    assert when.startswith("a in maniskill succeeds in ")
    assert "where table is 3 or more (35 dE*ab of the mean colour) and illuminance is 2 or more (1 EV darker), " in when
    needed = "indices need a suite with design: {kind: sobol}"
    known = "table and illuminance, by the failure clusters; which share of the differences is unknown"
    assert why == f"Why: {known}, {needed}."
    assert "1 failure cluster found on one half of the seeds and confirmed on the other (p <0.001" in sure
    assert sure.endswith("800 episodes at 200 points.")


def test_indices_are_named_largest_first():
    built = found(SOBOL, lambda cell, seed: severities(cell.condition).get("table", 0) < 2.5)
    _, why, sure = combinations.sentences(built.policies[0], built)
    assert why.startswith("Why: of the differences in success that the axes cause, alone or together, table in 100 %")
    assert "the axes explain 100 %" in sure
    assert combinations.index_table(built.policies[0]).rows[0][0] == "table"


def test_an_axis_is_not_said_to_matter_most_where_intervals_overlap():
    unsure = "which axis matters most is not shown"
    for bounds, said in (({"table": 2.5}, False), ({"table": 2.5, "illuminance": 2.5}, True)):
        built = found(SOBOL, lambda cell, seed, b=bounds: all(severities(cell.condition).get(a, 0) < b[a] for a in b))
        assert (unsure in combinations.sentences(built.policies[0], built)[2]) == said


def test_without_failures_nothing_is_claimed():
    built = found(SOBOL, lambda cell, seed: True)
    when, why, *_ = combinations.sentences(built.policies[0], built)
    assert when.endswith("no combination was shown to fail more often than the rest.")
    assert why == f"Why: unknown, {analysis.TOO_SMALL}."


def test_a_cluster_and_the_sentence_about_the_axes_do_not_contradict_each_other():
    """The clusters show that success depends on their axes, also where no index does."""
    built = found(SOBOL, fails_in_the_dark_on_another_table)
    one = replace(built.policies[0], sensitivity=Sensitivity(None, None), why_no_sensitivity=analysis.TOO_SMALL)
    assert one.clusters
    why = combinations.sentences(one, built)[1]
    assert why.startswith(
        "Why: table and illuminance, by the failure clusters; which share of the differences is unknown, "
    )


@pytest.mark.parametrize(
    ("shares", "highest", "kind", "other"),
    [
        ((0.1, 0.1), 3, "milder", 1.5),
        ((0.1, 0.1), 1, None, None),
        ((0.99, 0.99), 3, "harder", 5),
        ((0.99, 0.99), 5, None, None),
        ((0.9, 0.2), 3, None, None),
    ],
)
def test_a_saturated_design_is_named_with_a_milder_or_harder_one(shares, highest, kind, other):
    design = {**SPREAD, "max_severity": highest, "points": 50}

    def succeeds(cell, seed):
        return chance(cell, seed) < shares[severities(cell.condition).get("noise", 0) > 1]

    built = found(design, succeeds)
    last = combinations.sentences(built.policies[0], built)[-1]
    if kind is None:
        assert last.startswith("How sure: ")
    else:
        assert last.endswith(f"play a {kind} design, with severities up to {other} instead of {highest}.")


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
