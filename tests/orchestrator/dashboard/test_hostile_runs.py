"""Pages with runs that someone made to break them."""

import re
import time
from urllib.parse import quote

import pytest

from robogauntlet.orchestrator.dashboard import compare
from robogauntlet.orchestrator.dashboard.app_state import LONGEST_TEXT
from robogauntlet.orchestrator.dashboard.queries import MOST_NAMES, MOST_POLICIES
from robogauntlet.orchestrator.dashboard.runs import LONGEST_SUITE, MOST_CELLS, MOST_ROWS
from tests.orchestrator.dashboard.conftest import serving
from tests.orchestrator.dashboard.filled import HOSTILE_POLICIES, MARKUP, record_hostile_runs

HUGE = MARKUP * 80_000  # 3 MB
PAGES = (
    *(
        "/",
        "/runs",
        "/runs/many",
        "/runs/wide",
        "/runs/long",
        "/history?policy={}",
        "/history?policy=p",
        "/leaderboard",
        "/failures",
    ),
    *("/leaderboard?suite=synthetic", "/schedule", "/compare", "/compare?policies=wide", "/metrics", "/api/live"),
    *("/compare?run=wide&baseline=long", "/runs?policy={}", "/failures?policy={}"),
)


@pytest.fixture(scope="module")
def hostile(tmp_path_factory):
    root = tmp_path_factory.mktemp("hostile")
    with serving(root) as served:
        record_hostile_runs(served.history, root)
        with served.history.database.writing() as connection:
            for run_id in ("long", "small-1"):
                change = "UPDATE runs SET suite = ?, verdict = ?, reasons = ? WHERE run_id = ?"
                connection.exec_driver_sql(change, (HUGE, HUGE, HUGE, run_id))
        yield served


@pytest.mark.parametrize("path", PAGES)
def test_a_page_is_answered_soon_and_is_small(hostile, path):
    address = path.replace("{}", quote(HOSTILE_POLICIES[0], safe=""))
    began = time.monotonic()
    answer = hostile.get(address)
    assert time.monotonic() - began < 10  # less than a second on a machine that does nothing else
    assert answer.status_code == 200
    assert len(answer.content) < 4_000_000
    assert "<script>alert" not in answer.text
    assert "\u202e" not in answer.text


def test_a_large_table_says_that_it_is_cut(hostile):
    page = hostile.get("/runs/wide").text
    assert f"The first {MOST_ROWS} of 3,000 rows" in page
    assert f"The run has {MOST_CELLS + 1:,} cells, too many for this page" in hostile.get("/runs/many").text


def test_a_comparison_of_many_tasks_is_left_to_the_command(filled, monkeypatch):
    ids = [run.run_id for _, run, _ in filled.made]
    addresses = (f"/compare?policies={ids[0]}", f"/compare?run={ids[-1]}&baseline={ids[0]}")
    for address in addresses:
        assert "too many for this page" not in filled.get(address).text
    monkeypatch.setattr(compare, "MOST_LINES", 14)
    for address in addresses:
        answer = filled.get(address)
        assert answer.status_code == 200
        assert "The comparison has 15 lines, too many for this page" in answer.text
        assert "<table" not in answer.text


def test_a_long_suite_says_that_it_is_cut(hostile):
    assert f"The first {LONGEST_SUITE:,} of 3,000,000 characters" in hostile.get("/runs/long").text


def test_a_long_text_is_cut_with_its_length(hostile):
    assert f"... ({len(HUGE):,} characters)" in hostile.get("/runs/small-1").text
    assert len(HUGE) > LONGEST_TEXT


def test_lists_of_names_are_bounded(hostile):
    assert hostile.get("/compare").text.count('<option value="wide:') == 2 * MOST_POLICIES
    assert len(re.findall("<option", hostile.get("/runs").text)) <= 3 * MOST_NAMES + 3
