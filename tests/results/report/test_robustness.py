"""Severity curves and delivered values, as text and in the report's files."""

import json
import math
import re

import pytest

from robogauntlet.results.analysis.robustness import COLUMNS, build_robustness
from robogauntlet.results.report import robustness as words, write_report
from robogauntlet.results.report.findings import findings
from robogauntlet.suites.episode import Condition
from tests.results.analysis.test_robustness import GATED, PLAN, SEEDS, TASKS, built, rows
from tests.results.synthetic import cells, columns_of, document, rows_where, run_folder


def test_a_value_beyond_the_last_level_is_marked():
    assert words.half_lost_text(3.14, 5) == "3.1"
    assert words.half_lost_text(math.inf, 4) == ">4"
    assert words.half_lost_text(None, 5) == words.half_lost_text(math.nan, 5) == "–"


def test_the_table_of_an_axis_names_levels_in_their_unit():
    table = words.curves_table(built(), "noise")
    assert table.header[2:5] == ("clean", "2: 28", "4: 18.4")
    line = next(line for line in table.rows if line[:2] == ("merged", "all"))
    assert line[2].startswith("80 % [")
    assert line[4] == "0 % [0, 9]"
    assert line[-1] == "<0.001"


def test_the_delivered_table_sets_simulators_side_by_side():
    table = words.delivered_table(built())
    assert table.header == ("axis", "severity", "requested", "maniskill", "pybullet", "spread")
    assert table.rows[0] == ("noise", "2", "28 dB PSNR", "27.72", "28.28", "2 %")


def test_the_sentence_about_start_states_is_never_stronger_than_what_was_compared():
    sentence = words.start_states_sentence(built())
    assert sentence.startswith("All 240 episodes on axes that keep the start state started from")
    without_clean = words.start_states_sentence(built([r for r in rows() if r.axis != "clean"]))
    assert without_clean.startswith("Start states were not compared")


def test_of_a_single_level_none_is_called_the_lowest():
    conditions = (Condition(), Condition("noise", 4))
    plan = cells(("a", "b"), TASKS, conditions)
    single = build_robustness(document(SEEDS, of=plan), columns_of(rows_where(lambda *_: True, plan, SEEDS), COLUMNS))
    assert not [sentence for sentence in findings(single) if "lowest" in sentence]


@pytest.mark.parametrize(("won", "sentence"), [(False, "so that no axis can lower it"), (True, "no significant drop")])
def test_where_all_is_alike_no_level_is_the_lowest(won, sentence):
    plan = cells(("a",), TASKS, (Condition(), Condition("noise", 2), Condition("noise", 4)))
    alike = build_robustness(document(SEEDS, of=plan), columns_of(rows_where(lambda *_: won, plan, SEEDS), COLUMNS))
    (found,) = findings(alike)
    assert sentence in found


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    return write_report(run_folder(tmp_path_factory.mktemp("run") / "run", document(SEEDS, of=PLAN), rows()))


@pytest.fixture(scope="module")
def paths(report):
    return report.paths


def test_the_report_shows_a_chart_per_axis_and_all_numbers_as_text(paths):
    page, text = paths.html.read_text(), paths.markdown.read_text()
    assert page.count('<svg class="severity"') == 2
    assert page.count("<polyline") == 4
    for content in (page, text):
        assert "noise (dB PSNR)" in content
        assert "Delivered" in content


def test_the_summary_has_the_robustness_section(paths):
    found = json.loads(paths.summary.read_text())["robustness"]
    assert found["axes"] == ["noise", "blur"]
    assert found["start_states"] == {"compared": 240, "differing": 0}


def test_the_summary_has_the_findings_of_the_report(report):
    assert report.data["findings"]
    text = report.paths.markdown.read_text().replace("\\", "")
    assert all(f"- {sentence}" in text for sentence in report.data["findings"])


def test_a_no_skill_baseline_has_no_findings_since_it_has_no_skill_to_lose():
    assert any(sentence.startswith("merged: ") for sentence in findings(built()))
    assert not any(sentence.startswith("merged: ") for sentence in findings(built(no_skill_baselines=("merged",))))


def test_an_axis_without_a_scale_is_in_no_sentence_on_drops():
    plan = cells(("expert",), TASKS, (Condition(), Condition("instruction", 2), Condition("instruction", 4)))
    found = findings(built(rows_where(lambda cell, seed: True, plan, 5), plan))
    assert not any("drop" in sentence for sentence in found)


def test_a_capped_level_is_left_out_of_chart_and_table(tmp_path):
    def is_success(cell, seed):
        return cell.policy != "oracle" or cell.condition.severity < 4 or seed >= 3

    results = rows_where(is_success, GATED, SEEDS)
    run = document(SEEDS, of=GATED, oracle_gate="oracle")
    paths = write_report(run_folder(tmp_path / "run", run, results)).paths
    section = paths.html.read_text().partition('id="robustness"')[2].partition("</section>")[0]
    assert not re.search(r"\bnan\b", section)
    assert "level left out" in section
    page = paths.markdown.read_text()
    assert "noise@4 | 20 | 3 | level left out |" in page
    sentence = "expert succeeds in 40 of 40 perturbed episodes, in 20 of the 20 that count, and in 20 of the 20 left"
    assert sentence in page


def test_a_missing_gate_is_stated():
    plan = cells(("expert",), TASKS, (Condition(), Condition("blind", 1)))
    found = built(rows_where(lambda cell, seed: True, plan, 5), plan)
    assert words.oracle_gate_sentence(found).startswith("There is no oracle gate")


def test_a_run_without_perturbations_has_no_such_section(tmp_path):
    paths = write_report(run_folder(tmp_path / "run", document(1), [])).paths
    assert "Robustness" not in paths.html.read_text()
    assert json.loads(paths.summary.read_text())["robustness"] is None
