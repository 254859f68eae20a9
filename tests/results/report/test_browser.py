"""The report as a browser lays it out, at the width of a desk and of a phone."""

import pytest

from robogauntlet.results.report import write_report
from tests.contrast import CHROMIUM, check_contrast
from tests.frames import Frame, found_in
from tests.results.analysis.test_condition_comparison import COMPARE, PLAN, SEEDS, rows
from tests.results.routed import routed_document, routed_rows
from tests.results.synthetic import cells, document, rows_where, run_folder

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here: sudo apt-get install chromium"),
]
MEASURE = """
(page) => {
  const box = (e) => e.getBoundingClientRect();
  const drawn = (selector) => [...page.querySelectorAll(selector)].map(box).filter((b) => b.width > 40 && b.height > 9);
  const cell = page.querySelector(".maps td.right");
  return {
    width: page.documentElement.clientWidth,
    scroll: page.documentElement.scrollWidth,
    curves: drawn("svg.severity").length,
    forests: drawn("svg.losses").length,
    maps: drawn(".maps table").length,
    policies: page.querySelectorAll(".maps thead tr:first-child th").length,
    cells: page.querySelectorAll(".maps td.right").length,
    findings: page.querySelectorAll(".findings li").length,
    contents: [box(page.querySelector(".contents")).right, box(page.querySelector("main")).left],
    cut: [...page.querySelectorAll("#rates .scroll")].map((e) => e.scrollWidth - e.clientWidth),
    follows: page.defaultView.getComputedStyle(page.querySelector(".contents")).position,
    colour: cell && page.defaultView.getComputedStyle(cell).backgroundColor,
    broken: [...page.links].filter((a) => a.hash && !page.getElementById(a.hash.slice(1))).map((a) => a.hash),
    unnamed: [...page.querySelectorAll("svg[role=img]")].filter((s) => !s.getAttribute("aria-label")).length,
  };
}
"""
JUMP = """
(page) => {
  const box = (e) => e.getBoundingClientRect();
  const places = [];
  page.body.append(Object.assign(page.createElement("div"), { style: "height: 900px" }));
  for (const link of page.querySelectorAll(".contents a:not(.sub)")) {
    const target = page.getElementById(link.hash.slice(1));
    target.scrollIntoView();
    const bar = box(page.querySelector(".contents"));
    places.push([link.hash, bar.top, bar.bottom, box(target.querySelector("h2") || target).top]);
  }
  const root = page.documentElement;
  return { places, width: root.clientWidth, scroll: root.scrollWidth };
}
"""


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run") / "run"
    return write_report(run_folder(folder, document(SEEDS, of=PLAN, compare=COMPARE), rows())).paths.html.read_text()


@pytest.fixture(scope="module")
def wide_page(tmp_path_factory):
    """Of three simulators, and policies with long names."""
    plan = cells(("oracle", "zoo:unmerged-int4"))
    folder = run_folder(
        tmp_path_factory.mktemp("wide") / "run", document(of=plan), rows_where(lambda cell, seed: True, plan, 10)
    )
    return write_report(folder).paths.html.read_text()


@pytest.fixture(scope="module")
def found(page, wide_page, tmp_path_factory):
    """What the browser says about the report in frames of several widths (px)."""
    frames = {width: Frame(page, width, MEASURE) for width in (1400, 1280, 1120, 390)}
    frames |= {f"jump {width}": Frame(page, width, JUMP) for width in (1119, 390)}
    frames["wide"] = Frame(wide_page, 1200, MEASURE)
    return dict(zip(frames, found_in(frames.values(), tmp_path_factory.mktemp("found")), strict=True))


@pytest.mark.parametrize("width", [1280, 390])
def test_the_robustness_section_is_drawn_and_fits_the_page(found, width):
    found = found[width]
    assert found["scroll"] <= found["width"] <= width
    assert found["curves"] == 2  # one per axis
    assert found["forests"] == 1  # one per policy beside the baseline
    assert (found["maps"], found["policies"]) == (1, 2)
    assert found["cells"] == 2 * 5 * 3  # policies, conditions, simulators and all
    assert found["findings"] >= 4
    assert found["colour"] != "rgba(0, 0, 0, 0)"
    assert found["broken"] == []
    assert found["unnamed"] == 0


@pytest.mark.parametrize("width", [1400, 1280, 1120])
def test_the_contents_list_stays_beside_the_report_on_a_desk(found, width):
    found = found[width]
    assert found["scroll"] <= found["width"]
    assert found["contents"][0] <= found["contents"][1]
    assert found["follows"] == "sticky"


def test_rates_in_three_simulators_fit_a_small_desk(found):
    assert found["wide"]["cut"] == [0]


@pytest.mark.parametrize("width", [1119, 390])
def test_the_contents_list_stays_a_line_above_the_report_on_narrow_screens(found, width):
    found = found[f"jump {width}"]
    assert found["scroll"] <= found["width"]
    assert len(found["places"]) >= 8
    for link, top, bottom, heading in found["places"]:
        assert top == 0, link  # it stays
        assert 44 <= bottom <= 50, link  # one line, that a finger hits
        assert bottom <= heading < 300, link  # and covers nothing that a link leads to


@pytest.fixture(scope="module")
def merging_page(tmp_path_factory):
    folder = run_folder(tmp_path_factory.mktemp("merging") / "run", routed_document(), routed_rows())
    return write_report(folder).paths.html.read_text()


@pytest.mark.parametrize("dark", [False, True])
def test_every_text_of_the_report_is_readable(page, merging_page, tmp_path, dark):
    check_contrast([page, merging_page], tmp_path, dark=dark)
