"""The margin of non-inferiority on the page "Compare"."""

import html
import re

import pytest

from robogauntlet.results.api import compare, open_run
from robogauntlet.results.report.comparison import reasons
from robogauntlet.results.report.pairwise import sentences


def shown(page):
    """The text of a page."""
    return " ".join(html.unescape(re.sub(r"<[^>]*>", " ", page)).split())


def test_two_policies_are_compared_with_a_margin_as_by_the_command(filled):
    folder, run, _ = filled.made[-1]
    address = f"/compare?first={run.run_id}:merged&second={run.run_id}:experts"
    found = open_run(folder).compare("merged", "experts", margin=0.3)
    sentence = next(line for line in sentences(found.comparisons[0], found) if "no worse" in line)
    page = filled.get(f"{address}&margin=0.3").text
    assert sentence in shown(page)
    assert "by more than 30 points" in sentence
    assert 'class="margin"' in page
    assert "no worse than" not in shown(filled.get(address).text)


def test_all_policies_of_a_run_are_compared_with_a_margin(filled):
    page = filled.get(f"/compare?first={filled.made[-1][1].run_id}&margin=0.25").text
    assert "by more than 25 points" in shown(page)


def test_runs_are_compared_with_the_margin_of_their_suite_unless_one_is_given(filled):
    (good, run, _), (worse, baseline, _) = filled.made[0], filled.made[-1]
    reason = next(reason for reason in reasons(compare(good, worse, margin=0.4)) if "40 points" in reason)
    address = f"/compare?first={run.run_id}&second={baseline.run_id}"
    assert reason in shown(filled.get(f"{address}&margin=0.4").text)
    assert "by more than 5 points" in shown(filled.get(f"{address}&margin=").text)


def test_the_form_keeps_the_margin(filled):
    run_id = filled.made[-1][1].run_id
    page = filled.get(f"/compare?first={run_id}&margin=0.1").text
    (field,) = re.findall(r'<input name="margin"[^>]*>', page)
    assert 'value="0.1"' in field


@pytest.mark.parametrize("margin", ["0", "1", "-0.1", "nan", "inf", "1e999", "a", "<b>", "٠.٥", "0.1 points"])
def test_a_margin_that_is_no_share_is_one_line(filled, margin):
    run_id = filled.made[-1][1].run_id
    answer = filled.get("/compare", params={"first": run_id, "margin": margin})
    assert answer.status_code == 400
    assert "margin: expected a share from 0.0001 to 0.9999" in shown(answer.text)
