"""The pages in a real browser: names are never run as scripts, and numbers change without a reload."""

import re
import subprocess
from urllib.parse import quote

import pytest

from robogauntlet.results.live_status import LiveSimulator, LiveWorker
from robogauntlet.results.run_document import RunStatus
from robogauntlet.results.store.history_records import Counts
from robogauntlet.suites.episode import Cell, Protocol
from tests.contrast import CHROMIUM, check_contrast
from tests.frames import Frame, found_in
from tests.orchestrator.dashboard.conftest import serving
from tests.orchestrator.dashboard.filled import live_status, running
from tests.results.synthetic import document, row, run_folder

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here: sudo apt-get install chromium"),
]
OWN = "document.documentElement.dataset.owned=1"
BAD = f"x'\"><script>{OWN}</script><img src=x onerror={OWN}>"
WIDTHS = """
(page) => [page.documentElement.clientWidth, page.documentElement.scrollWidth]
"""


def seen(address, profile, budget=3000):
    """The page after `budget` milliseconds of the browser's time."""
    command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={profile}"]
    command += ["--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1", f"--virtual-time-budget={budget}"]
    done = subprocess.run([*command, "--dump-dom", address], capture_output=True, text=True, timeout=120, check=True)
    return done.stdout


def bad_live(done=5):
    line = LiveSimulator(simulator=BAD, planned=10, successes=done, failures=0, errors=0)
    worker = LiveWorker(worker=BAD, simulator=BAD, activity=f"{BAD} {done}", since=0.0)
    return live_status(1).model_copy(
        update={"phase": BAD, "simulators": (line,), "workers": (worker,), "messages": (BAD,)}
    )


def is_owned(page):
    return "data-owned" in re.search(r"<html[^>]*>", page)[0] or re.search(r"<img[^>]*onerror", page) is not None


def test_a_script_in_a_name_is_shown_and_not_run(tmp_path):
    of = [Cell(policy, policy, f"null/{BAD}", Protocol(horizon=10)) for policy in (BAD, "other")]
    named = {"description": BAD, "reason": BAD, "suite_text": BAD}
    with serving(tmp_path) as served:
        for run_id, status in (("one", "failure"), ("two", "success")):
            results = [row(cell, seed, status) for cell in of for seed in range(9)]
            run = document(9, of=of, run_id=run_id, **named)
            folder = run_folder(tmp_path / run_id, run, results)
            counted = {(cell.policy_digest, cell.task, "clean", 0): Counts(9, 9) for cell in of}
            served.history.record(run, folder, counted)
        served.history.write_verdict("two", BAD, "one", [BAD])
        running(served.history, bad_live())
        paths = (
            "/",
            "/runs/two",
            "/runs/running-1",
            "/compare?first=one&second=two",
            "/compare?first=two",
            "/leaderboard?suite={}",
        )
        paths += ("/history?policy={}", "/runs?suite={}", "/failures?run=one&policy={}&task={}")
        for path in paths:
            page = seen(served.address + path.replace("{}", quote(BAD, safe="")), tmp_path / "profile")
            assert "&lt;script&gt;" in page, path
            assert not is_owned(page), path


def test_numbers_change_without_a_reload(tmp_path):
    polls = []

    def write_status(served, path):
        if path == "/api/live":
            polls.append(path)
            served.history.write_live_status("running-1", live_status(120 + 7 * len(polls)))

    with serving(tmp_path, before=write_status) as served:
        running(served.history, live_status(120))
        page = seen(served.address + "/", tmp_path / "profile", 9000)
        pages = served.requested.count("/")
    assert pages == 1
    last = max(int(number) for number in re.findall(r'data-field="done">(\d+)<', page))
    assert last > 121
    assert len(polls) >= 2
    assert f'aria-valuenow="{last}"' in page
    assert "of 1,500 episodes" in re.search(r'id="announced">([^<]*)<', page)[1]


def test_a_script_in_a_later_message_is_not_run(tmp_path):
    number = iter(range(1, 99))

    def write_status(served, path):
        if path == "/api/live":
            served.history.write_live_status("running-1", bad_live(next(number)))

    with serving(tmp_path, before=write_status) as served:
        running(served.history, bad_live(0))
        page = seen(served.address + "/", tmp_path / "profile", 7000)
    assert not is_owned(page)
    assert re.search(r'data-field="doing">[^<]*&lt;script&gt;.* [1-9]\d*<', page)


def test_a_run_that_ends_shows_its_outcome_without_a_reload(tmp_path):
    def end(served, path):
        if path == "/api/live":
            run = served.history.document("running-1")
            served.history.record(run.model_copy(update={"status": RunStatus.COMPLETE}))

    with serving(tmp_path, before=end) as served:
        running(served.history, live_status(120))
        page = seen(served.address + "/runs/running-1", tmp_path / "profile", 7000)
    assert 'class="pill complete"' in page
    assert "progressbar" not in page


def test_old_numbers_are_marked_when_the_server_fails(tmp_path):
    def fail(served, path):
        if path == "/api/live":
            with served.history.database.writing() as connection:
                connection.exec_driver_sql("UPDATE runs SET started_at = 'no time'")

    with serving(tmp_path, before=fail) as served:
        running(served.history, live_status(120))
        page = seen(served.address + "/", tmp_path / "profile", 5000)
    assert re.search(r'id="note"[^>]*>The server does not answer', page)


PAGES = (
    *("/", "/runs", "/run", "/history?policy=merged", "/leaderboard?suite=nightly", "/failures", "/schedule"),
    *("/compare", "/compare?first={}", "/compare?first={}:experts&second={}:merged"),
)


def page_with_style(filled, path):
    run_id = filled.made[-1][1].run_id
    page = filled.get(f"/runs/{run_id}" if path == "/run" else path.replace("{}", run_id)).text
    for link in re.findall(r'<link rel="stylesheet"[^>]*>', page):
        style = filled.get(re.search(r'href="([^"]+)"', link)[1]).text
        page = page.replace(link, f"<style>{style}</style>")
    return page


@pytest.mark.parametrize("dark", [False, True])
def test_every_text_is_readable(filled, tmp_path, dark):
    check_contrast([page_with_style(filled, path) for path in PAGES], tmp_path, dark=dark)


@pytest.fixture(scope="module")
def widths_on_a_phone(filled, tmp_path_factory):
    """Path to the width of the phone and that of the page."""
    frames = [Frame(page_with_style(filled, path), 380, WIDTHS) for path in PAGES]
    return dict(zip(PAGES, found_in(frames, tmp_path_factory.mktemp("phone")), strict=True))


@pytest.mark.parametrize("path", PAGES)
def test_a_page_fits_a_phone(widths_on_a_phone, path):
    width, scroll = widths_on_a_phone[path]
    assert 0 < scroll <= width <= 380
