"""Answers when something fails, and while others write."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from robogauntlet.orchestrator.dashboard.answers import Answers
from tests.orchestrator.dashboard.conftest import fill, serving
from tests.orchestrator.dashboard.filled import live_status, running

PAGES = (
    *("/", "/runs", "/runs/x", "/history?policy=merged", "/leaderboard?suite=a"),
    *("/failures", "/schedule", "/compare"),
)
FOR_PROGRAMS = ("/api/live", "/metrics", "/healthz")


@pytest.fixture(scope="module")
def broken(tmp_path_factory):
    """A dashboard whose store was overwritten with something else."""
    root = tmp_path_factory.mktemp("broken")
    fill(root, nights=1)
    with serving(root) as served:
        assert served.get("/healthz").text == "ok\n"
        for one in (served.history, served.schedule_store):
            one.close()  # what is connected keeps what it has read
        (root / "garbage").write_bytes(b"garbage, and much of it. " * 9999)
        (root / "garbage").replace(root / "history.sqlite")
        yield served


@pytest.mark.parametrize("path", [*PAGES, *FOR_PROGRAMS])
def test_a_broken_store_is_one_line_without_a_traceback(broken, path):
    answer = broken.get(path)
    assert answer.status_code == 503
    assert "Traceback" not in answer.text
    assert "sqlalchemy" not in answer.text.lower()
    assert ".py" not in answer.text
    if path in PAGES:
        assert "<h1>Unavailable</h1>" in answer.text
    elif path == "/api/live":
        assert list(answer.json()) == ["error"]
    else:
        assert len(answer.text.splitlines()) == 1


def test_an_unexpected_error_is_one_line_without_a_traceback(tmp_path):
    with serving(tmp_path) as served:
        running(served.history)
        with served.history.database.writing() as connection:
            connection.exec_driver_sql("UPDATE runs SET started_at = 'no time'")
        page, programs = served.get("/"), served.get("/api/live")
    assert (page.status_code, programs.status_code) == (500, 500)
    assert "Internal error" in page.text
    assert programs.json() == {"error": "An internal error; see the log of the server."}


def test_fifty_readers_see_no_error_while_a_run_reports(tmp_path):
    fill(tmp_path, nights=1)
    answers, ended = [], threading.Event()
    with serving(tmp_path) as served:
        running(served.history)

        def write():
            done = 0
            while not ended.wait(0.05):
                done += 1
                served.history.write_live_status("running-1", live_status(done))

        def read(number):
            for turn in range(4):
                path = ("/", "/api/live", "/runs", "/runs/running-1", "/metrics")[(number + turn) % 5]
                answers.append((path, served.get(path).status_code))

        writer = threading.Thread(target=write)
        writer.start()
        with ThreadPoolExecutor(50) as readers:
            list(readers.map(read, range(50)))
        ended.set()
        writer.join()
        assert served.get("/api/live").json()["runs"][0]["done"] > 0
    assert len(answers) == 200
    assert {status for _, status in answers} == {200}


def test_simultaneous_requests_compute_a_slow_answer_once():
    answers, made = Answers(2), []

    def make():
        time.sleep(0.05)
        made.append(1)
        return "answer"

    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(answers.get, ["key"] * 8, [make] * 8))
    assert found == ["answer"] * 8
    assert made == [1]


def test_an_answer_does_not_wait_for_another():
    answers, begun, ended = Answers(2), threading.Event(), threading.Event()
    with ThreadPoolExecutor(1) as pool:
        slow = pool.submit(answers.get, "slow", lambda: begun.set() or ended.wait(60))
        assert begun.wait(60)
        assert answers.get("quick", lambda: "answer") == "answer"
        ended.set()
        assert slow.result()


def test_old_answers_are_dropped_and_errors_are_not_cached():
    answers = Answers(2)
    assert [answers.get(key, lambda key=key: key) for key in "abca"] == [*"abca"]
    assert answers.get("a", lambda: "new") == "a"
    assert answers.get("b", lambda: "new") == "new"
    with pytest.raises(ZeroDivisionError):
        answers.get("d", lambda: 1 / 0)
    assert answers.get("d", lambda: "right") == "right"


def test_an_answer_expires():
    answers = Answers(2)
    answers.get("a", lambda: "old", seconds=0.001)
    time.sleep(0.01)
    assert answers.get("a", lambda: "new") == "new"
