"""Severity curves and delivered values as words, and in the report's files."""

import json
import math

import pytest

from results.report import robustness as words
from results.report import write_report
from results.statistics.rates import Estimate, Interval
from tests.results.synthetic import document, run_folder
from tests.results.test_robustness import PLAN, SEEDS, built, rows


def test_what_is_beyond_the_last_level_says_so():
    assert words.severity(Estimate(3.14, Interval(2.6, math.inf)), 5) == "3.1 [2.6, >5]"
    assert words.severity(Estimate(math.inf, Interval(4.0, math.inf)), 4) == ">4 [4.0, >4]"
    assert words.severity(None, 5) == words.severity(Estimate(math.nan, None), 5) == "–"


def test_the_table_of_an_axis_names_levels_in_their_unit():
    table = words.curves_table(built(), "noise")
    assert table.header[2:5] == ("clean", "2: 28", "4: 18.4")
    line = next(line for line in table.rows if line[:2] == ("merged", "all"))
    assert line[2].startswith("80 % [")
    assert line[4] == "0 % [0, 9]"
    assert line[-1] == "<0.001"


def test_the_delivered_table_sets_simulators_side_by_side():
    table = words.delivered_table(built())
    assert table.header == ("axis", "severity", "asked", "maniskill", "pybullet", "apart")
    assert table.rows[0] == ("noise", "2", "28 dB PSNR", "27.72", "28.28", "2 %")


def test_the_sentence_about_worlds_is_never_stronger_than_what_was_compared():
    assert words.worlds(built()).startswith("All of 240 perturbed episodes started from the physical state")
    assert words.worlds(built([r for r in rows() if r.axis != "clean"])).startswith("No perturbed episode has a clean")


@pytest.fixture(scope="module")
def paths(tmp_path_factory):
    return write_report(run_folder(tmp_path_factory.mktemp("run") / "run", document(SEEDS, of=PLAN), rows()))


def test_the_report_shows_a_chart_per_axis_and_all_numbers_as_text(paths):
    page, text = paths.html.read_text(), paths.markdown.read_text()
    assert page.count('<svg class="severity"') == 2
    assert page.count("<polyline") == 4
    for content in (page, text):
        assert "noise (N1): sensor noise, dB PSNR" in content
        assert "Delivered" in content


def test_the_summary_has_it_too(paths):
    found = json.loads(paths.summary.read_text())["robustness"]
    assert found["axes"] == ["noise", "blur"]
    assert found["worlds"] == {"compared": 240, "differing": 0}


def test_a_run_without_perturbations_has_no_such_section(tmp_path):
    paths = write_report(run_folder(tmp_path / "run", document(1), []))
    assert "Robustness" not in paths.html.read_text()
    assert json.loads(paths.summary.read_text())["robustness"] is None
