"""The report as a browser lays it out, at the width of a desk and of a phone."""

import html
import json
import re
import subprocess

import pytest

from robogauntlet.results.report import write_report
from tests.contrast import CHROMIUM, check_contrast
from tests.results.analysis.test_condition_comparison import COMPARE, PLAN, SEEDS, rows
from tests.results.routed import routed_document, routed_rows
from tests.results.synthetic import cells, document, rows_where, run_folder

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here: sudo apt-get install chromium"),
]
MEASURE = """
<!doctype html><body><iframe id="page" width="{width}" height="900" srcdoc="{page}"></iframe><pre id="found"></pre>
<script>
onload = () => {{
  const page = document.getElementById("page").contentDocument;
  const box = (e) => e.getBoundingClientRect();
  const drawn = (selector) => [...page.querySelectorAll(selector)].map(box).filter((b) => b.width > 40 && b.height > 9);
  const cell = page.querySelector(".maps td.right");
  document.getElementById("found").textContent = JSON.stringify({{
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
  }});
}};
</script></body>
"""
JUMP = """
<!doctype html><body><iframe id="page" width="{width}" height="900" srcdoc="{page}"></iframe><pre id="found"></pre>
<script>
onload = () => {{
  const page = document.getElementById("page").contentDocument;
  const box = (e) => e.getBoundingClientRect();
  const places = [];
  page.body.append(Object.assign(page.createElement("div"), {{ style: "height: 900px" }}));
  for (const link of page.querySelectorAll(".contents a:not(.sub), .axes a")) {{
    const target = page.getElementById(link.hash.slice(1));
    target.scrollIntoView();
    const bar = box(page.querySelector(".contents"));
    places.push([link.hash, bar.top, bar.bottom, box(target.querySelector("h2") || target).top]);
  }}
  const root = page.documentElement;
  const widths = {{ width: root.clientWidth, scroll: root.scrollWidth }};
  document.getElementById("found").textContent = JSON.stringify({{ places, ...widths }});
}};
</script></body>
"""
CHOOSE = """
<!doctype html><body><iframe id="page" width="1000" height="900" srcdoc="{page}"></iframe><pre id="found"></pre>
<script>
onload = () => {{
  const page = document.getElementById("page").contentDocument;
  page.querySelector("[name=axis]").value = "blur";
  page.querySelector("[name=policy]").checked = false;
  for (const simulator of page.querySelectorAll("[name=simulator]")) simulator.checked = true;
  page.querySelector("[name=axis]").dispatchEvent(new Event("change", {{ bubbles: true }}));
  setTimeout(() => {{
    const ticks = [...page.querySelectorAll("#lines .xtick text, #lines .xtitle")].map((tick) => tick.textContent);
    const lines = page.querySelectorAll("#lines .trace.scatter").length;
    document.getElementById("found").textContent = JSON.stringify([lines, ticks]);
  }}, 1000);
}};
</script></body>
"""
PHONE = """
<!doctype html><body><iframe id="page" width="390" height="900" srcdoc="{page}"></iframe><pre id="found"></pre>
<script>
onload = () => {{
  const page = document.getElementById("page").contentDocument;
  const touched = [...page.querySelectorAll(".controls select, .controls fieldset label")];
  const boxes = touched.map((e) => e.getBoundingClientRect());
  const size = (e) => parseFloat(page.defaultView.getComputedStyle(e).fontSize);
  document.getElementById("found").textContent = JSON.stringify({{
    width: page.documentElement.clientWidth,
    scroll: page.documentElement.scrollWidth,
    heights: boxes.map((box) => box.height),
    ends: boxes.map((box) => box.right),
    font: Math.min(...[...page.querySelectorAll("select")].map(size)),
  }});
}};
</script></body>
"""


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run") / "run"
    return write_report(run_folder(folder, document(SEEDS, of=PLAN, compare=COMPARE), rows())).paths.html.read_text()


def html_after_scripts(address, folder, *options):
    """The page once its scripts have run."""
    command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={folder / 'profile'}"]
    command += [*options, "--dump-dom", address]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout


def measured(page, width, folder):
    """What the browser says about the page in a frame of that width (px)."""
    file = folder / "measure.html"
    file.write_text(MEASURE.format(width=width, page=html.escape(page, quote=True)))
    found = html_after_scripts(file.as_uri(), folder, "--virtual-time-budget=5000")
    return json.loads(html.unescape(re.search(r'<pre id="found">(.*?)</pre>', found, re.DOTALL)[1]))


@pytest.mark.parametrize("width", [1280, 390])
def test_the_robustness_section_is_drawn_and_fits_the_page(page, width, tmp_path):
    found = measured(page, width, tmp_path)
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
def test_the_contents_list_stays_beside_the_report_on_a_desk(page, width, tmp_path):
    found = measured(page, width, tmp_path)
    assert found["scroll"] <= found["width"]
    assert found["contents"][0] <= found["contents"][1]
    assert found["follows"] == "sticky"


def test_rates_in_three_simulators_fit_a_small_desk(tmp_path):
    plan = cells(("oracle", "zoo:unmerged-int4"))
    folder = run_folder(tmp_path / "run", document(of=plan), rows_where(lambda cell, seed: True, plan, 10))
    found = measured(write_report(folder).paths.html.read_text(), 1200, tmp_path)
    assert found["cut"] == [0]


@pytest.mark.parametrize("width", [1119, 390])
def test_the_contents_list_stays_a_line_above_the_report_on_narrow_screens(page, width, tmp_path):
    file = tmp_path / "jump.html"
    file.write_text(JUMP.format(width=width, page=html.escape(page, quote=True)))
    shown = html_after_scripts(file.as_uri(), tmp_path, "--virtual-time-budget=5000")
    found = json.loads(html.unescape(re.search(r'<pre id="found">(.*?)</pre>', shown, re.DOTALL)[1]))
    assert found["scroll"] <= found["width"]
    assert len(found["places"]) >= 8
    for link, top, bottom, heading in found["places"]:
        assert top == 0, link  # it stays
        assert 44 <= bottom <= 50, link  # one line, that a finger hits
        assert bottom <= heading < 300, link  # and covers nothing that a link leads to


def test_the_interactive_page_is_drawn_without_a_network(tmp_path):
    folder = run_folder(tmp_path / "run", document(SEEDS, of=PLAN, compare=COMPARE), rows())
    address = write_report(folder).paths.explorer.as_uri()
    offline = ("--host-resolver-rules=MAP * ~NOTFOUND", "--virtual-time-budget=8000")
    body = html_after_scripts(address, tmp_path, *offline).partition("<body>")[2]
    assert body.count("<select") == 2  # to choose the axis, and the policy
    assert body.count('class="trace scatter') == 2  # expert and merged, over all simulators
    assert 'class="hm"' in body


def test_controls_of_the_interactive_page_choose_axis_and_policies(tmp_path):
    folder = run_folder(tmp_path / "run", document(SEEDS, of=PLAN, compare=COMPARE), rows())
    page = write_report(folder).paths.explorer.read_text()
    file = tmp_path / "choose.html"
    file.write_text(CHOOSE.format(page=html.escape(page, quote=True)))
    found = html_after_scripts(file.as_uri(), tmp_path, "--virtual-time-budget=8000")
    lines, ticks = json.loads(html.unescape(re.search(r'<pre id="found">(.*?)</pre>', found, re.DOTALL)[1]))
    assert lines == 3  # of the policy that is left: all simulators and each of the two
    assert ticks == ["clean", "20.6", "41.8", "severity, and its level in % of image width"]


def test_controls_of_the_interactive_page_can_be_touched_on_a_phone(tmp_path):
    folder = run_folder(tmp_path / "run", document(SEEDS, of=PLAN, compare=COMPARE), rows())
    page = write_report(folder).paths.explorer.read_text().replace("> merged<", f"> {'merged' * 20}<")
    file = tmp_path / "phone.html"
    file.write_text(PHONE.format(page=html.escape(page, quote=True)))
    shown = html_after_scripts(file.as_uri(), tmp_path, "--virtual-time-budget=8000")
    found = json.loads(html.unescape(re.search(r'<pre id="found">(.*?)</pre>', shown, re.DOTALL)[1]))
    assert found["scroll"] <= found["width"] <= 390
    assert len(found["heights"]) == 2 + 2 + 3  # choices of axis and policy, two policies, three places
    assert min(found["heights"]) >= 44  # pixels that a finger hits
    assert max(found["ends"]) <= found["width"]
    assert found["font"] >= 16  # with smaller texts some browsers enlarge the page


@pytest.mark.parametrize("dark", [False, True])
def test_every_text_of_the_report_is_readable(page, tmp_path, dark):
    run = routed_document()
    merging = write_report(run_folder(tmp_path / "run", run, routed_rows())).paths.html.read_text()
    explorer = tmp_path / "perturbed"
    explorer = write_report(run_folder(explorer, document(SEEDS, of=PLAN, compare=COMPARE), rows())).paths.explorer
    check_contrast([page, merging, explorer.read_text()], tmp_path, dark=dark)
