"""Tables of the report that a browser sorts and filters: with the mouse, the keyboard and a finger, and offline."""

import re

import pytest

from robogauntlet.results.report import write_report
from robogauntlet.suites.episode import Condition
from tests.contrast import CHROMIUM, check_contrast
from tests.frames import Frame, found_in
from tests.results.synthetic import cells, document, row, run_folder

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here: sudo apt-get install chromium"),
]
POLICIES = ("ten", "two", "broken", "<b>all</b>")
SUCCESSES = {"ten": 10, "two": 2, "broken": 0, "<b>all</b>": 12}
SEEDS = 12
TASKS = tuple(f"null/Task{number}" for number in (10, 9, 1))
ASK = """
(page) => {
  const table = page.querySelector("#counts table");
  const heads = [...table.tHead.rows[0].cells];
  const named = (name) => heads.find((head) => head.textContent === name).querySelector("button");
  const column = (name) => {
    const place = heads.findIndex((head) => head.textContent === name);
    return [...table.tBodies[0].rows].filter((row) => !row.hidden).map((row) => row.cells[place].textContent);
  };
  const said = () => heads.map((head) => head.ariaSort).filter(Boolean);
  const found = { written: column("policy"), rate: [], task: [], said: [] };
  for (const press of [1, 2, 3]) {
    named("rate").click();
    found.rate.push(column("rate"));
    found.said.push(said());
  }
  found.restored = column("policy");
  named("task").click();
  found.task = column("task");
  const field = page.querySelector("#counts input");
  field.value = "TWO task9";
  field.dispatchEvent(new Event("input"));
  found.filtered = [column("task"), column("policy")];
  found.count = page.querySelector("#counts output").textContent;
  found.label = field.ariaLabel;
  field.value = "";
  field.dispatchEvent(new Event("input"));
  found.unfiltered = column("task").length;
  found.empty = page.querySelector("#counts output").textContent;
  return found;
}
"""
TOUCHED = """
(page) => {
  const controls = [...page.querySelectorAll(".sortable button, .filter input")].filter((one) => one.checkVisibility());
  const boxes = controls.map((one) => one.getBoundingClientRect());
  const field = page.querySelector("#counts input");
  return {
    reached: controls.map((one) => one.tabIndex),
    heights: boxes.map((box) => box.height),
    matrix: [...page.querySelectorAll(".matrix button")].map((one) => one.getBoundingClientRect().right),
    field: field.getBoundingClientRect().right,
    font: parseFloat(page.defaultView.getComputedStyle(field).fontSize),
    width: page.documentElement.clientWidth,
    scroll: page.documentElement.scrollWidth,
    short: page.querySelectorAll("#time button, #time input").length,
    heat: page.querySelectorAll(".heat button").length,
  };
}
"""
PLAIN = """
(page) => [page.querySelectorAll("table").length, page.querySelectorAll(".scroll button, .filter").length]
"""


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    plan = cells(POLICIES, TASKS, (Condition(), Condition("noise", 4)))
    results = [
        row(cell, seed, "error" if cell.policy == "broken" else ("failure", "success")[seed < SUCCESSES[cell.policy]])
        for cell in plan
        for seed in range(SEEDS)
    ]
    folder = run_folder(tmp_path_factory.mktemp("tables") / "run", document(SEEDS, of=plan), results)
    return write_report(folder).paths.html.read_text()


@pytest.fixture(scope="module")
def found(page, tmp_path_factory):
    """What the browser finds: after presses and words in the field, on a desk and a phone, and without the script."""
    asked = [(page, 1280, ASK), (page, 1280, TOUCHED), (page, 390, TOUCHED)]
    frames = [Frame(*one) for one in (*asked, (re.sub("sha256-.", "sha256-!", page), 1280, PLAIN))]
    return found_in(frames, tmp_path_factory.mktemp("found"))


def test_a_head_sorts_upwards_then_downwards_then_as_written(found):
    upwards, downwards, written = found[0]["rate"]
    shown = ["17 %"] * 6 + ["83 %"] * 6 + ["100 %"] * 6
    assert upwards == [*shown, *["–"] * 6]
    assert downwards == [*reversed(shown), *["–"] * 6]  # what is missing stays below
    assert found[0]["said"] == [["ascending"], ["descending"], []]
    assert written[:2] != upwards[:2]
    assert found[0]["restored"] == found[0]["written"]


def test_names_with_numbers_are_sorted_as_people_count(found):
    assert list(dict.fromkeys(found[0]["task"])) == ["Task1", "Task9", "Task10"]


def test_the_field_shows_the_rows_that_have_all_words_and_counts_them(found):
    assert found[0]["filtered"] == [["Task9"] * 2, ["two"] * 2]
    assert found[0]["count"] == "2 of 24 rows"
    assert found[0]["label"] == "Filter rows: null: episodes and rates per task"
    assert (found[0]["unfiltered"], found[0]["empty"]) == (24, "")


@pytest.mark.parametrize("place", [1, 2])
def test_controls_of_tables_are_reached_with_the_keyboard(found, place):
    assert len(found[place]["reached"]) > 10
    assert set(found[place]["reached"]) == {0}


@pytest.mark.parametrize("place", [1, 2])
def test_the_page_stays_as_wide_as_its_window(found, place):
    assert found[place]["scroll"] <= found[place]["width"]


def test_controls_of_tables_can_be_touched_on_a_phone(found):
    phone = found[2]
    assert min(phone["heights"]) >= 44  # pixels that a finger hits
    assert phone["matrix"]  # rates can be sorted though their heads are no columns there
    assert max([*phone["matrix"], phone["field"]]) <= phone["width"] <= 390
    assert phone["font"] >= 16  # with smaller texts some browsers enlarge the page


def test_short_tables_and_heat_maps_have_no_controls(found):
    assert (found[1]["short"], found[1]["heat"]) == (0, 0)


def test_without_the_script_the_tables_stay_as_written(found):
    tables, controls = found[3]
    assert tables > 3
    assert controls == 0


@pytest.mark.parametrize("dark", [False, True])
def test_every_control_of_tables_is_readable(page, tmp_path, dark):
    check_contrast([page], tmp_path, dark=dark)
