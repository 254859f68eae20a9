"""The interactive plots as a browser draws them: labels can be read, and values need no mouse."""

import re

import pytest

from robogauntlet.results.report import write_report
from robogauntlet.suites.episode import Condition
from tests.contrast import CHROMIUM
from tests.frames import Frame, found_in
from tests.results.synthetic import cells, document, rows, run_folder

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here: sudo apt-get install chromium"),
]
CONDITIONS = tuple(Condition(axis, severity) for axis, severity in (("clean", 0), ("noise", 4), ("blind", 1)))
TASKS = tuple(f"simulator{number % 3}/PandaPickAndPlaceWithLongName{number}-v3" for number in range(30))
ASK = """
async (page) => {
  const folds = [...page.querySelectorAll("details")];
  for (const fold of folds) fold.querySelector("summary").click(); // as the Enter key does
  await new Promise((done) => setTimeout(done, 1500));
  const cells = (rows) => [...rows].map((row) => [...row.cells].map((cell) => cell.textContent));
  const tables = folds.map((fold) => cells(fold.querySelectorAll("tr")));
  const labels = [...page.querySelectorAll("#map .xtick text, #map .ytick text")];
  return {
    labels: labels.map((label) => label.textContent),
    boxes: labels.map((label) => label.getBoundingClientRect()),
    plot: page.querySelector("#map .main-svg").getBoundingClientRect(),
    width: page.documentElement.clientWidth,
    scroll: page.documentElement.scrollWidth,
    reached: [...page.querySelectorAll("summary, .wide")].map((one) => one.tabIndex),
    tables,
  };
}
"""
COUNTS, WIDTHS = (2, 9, len(TASKS)), (1280, 390)


def explorer(folder, tasks):
    plan = cells(("first", "second <b>"), tasks, CONDITIONS)
    return write_report(run_folder(folder / "run", document(1, of=plan), rows(plan, 1))).paths.explorer.read_text()


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """Number of tasks and width of a frame (px), to what a browser says about the page in it."""
    pages = {count: explorer(tmp_path_factory.mktemp("explorer"), TASKS[:count]) for count in COUNTS}
    cases = [(count, width) for count in COUNTS for width in WIDTHS]
    frames = [Frame(pages[count], width, ASK) for count, width in cases]
    return dict(zip(cases, found_in(frames, tmp_path_factory.mktemp("seen")), strict=True))


def overlap(one, other):
    """Whether boxes share more than the border of a letter."""
    return all(
        min(one[end], other[end]) - max(one[start], other[start]) > 1
        for start, end in (("left", "right"), ("top", "bottom"))
    )


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("count", COUNTS)
def test_labels_of_the_heat_map_can_be_read(seen, count, width):
    found = seen[count, width]
    boxes = found["boxes"]
    assert found["labels"][:count] == list(TASKS[:count])
    assert [
        (found["labels"][a], found["labels"][b])
        for a in range(len(boxes))
        for b in range(a)
        if overlap(boxes[a], boxes[b])
    ] == []
    assert max(box["bottom"] for box in boxes) <= found["plot"]["bottom"]
    assert found["scroll"] <= found["width"]  # a wide map scrolls in its place


def test_values_can_be_read_without_a_mouse(seen):
    found = seen[2, 1280]
    assert found["reached"] == [0, 0, 0]
    lines, cells_of = found["tables"]
    assert lines[0] == ["policy", "simulator", "severity", "success", "95 % interval", "episodes"]
    assert {row[0] for row in lines[1:]} == {"first", "second <b>"}
    assert [row[2] for row in lines[1:3]] == ["clean", "4: 18.4 dB PSNR"]
    assert cells_of[0] == ["condition", *TASKS[:2]]
    assert [row[0] for row in cells_of[1:]] == ["clean", "noise@4: 18.4 dB PSNR", "blind"]
    assert all(re.fullmatch(r"(0|100) % \[\d+, \d+\], 1 episode", value) for row in cells_of[1:] for value in row[1:])
