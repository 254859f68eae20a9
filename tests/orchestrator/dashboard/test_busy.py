"""Answers while slow pages are computed."""

import socket
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from urllib.parse import urlsplit

import pytest

from robogauntlet.orchestrator.cli.serve.dashboard import SWITCH_S, listen
from robogauntlet.orchestrator.dashboard import app_state, compare
from robogauntlet.results.run_document import RunError
from robogauntlet.results.store.database import file_url
from tests.orchestrator.dashboard.conftest import fill, serving
from tests.processes import environment_of, run_process

ASKING = 50
"""More than the threads that all pages share."""


@pytest.fixture
def slow_disk(monkeypatch):
    """Runs cannot be opened for comparisons until the event is set."""
    read, really = threading.Event(), compare.open_entry

    def open_slowly(*arguments):
        assert read.wait(120)
        return really(*arguments)

    monkeypatch.setattr(compare, "open_entry", open_slowly)
    yield read
    read.set()


def test_many_comparisons_delay_no_other_page(tmp_path, monkeypatch):
    read = threading.Event()

    def fail_late(*_):
        assert read.wait(120)
        raise RunError("the disk is broken")

    monkeypatch.setattr(compare, "open_entry", fail_late)
    ((_, run, _),) = fill(tmp_path, nights=1)
    with serving(tmp_path) as served, ThreadPoolExecutor(ASKING) as clients:
        paths = [f"/compare?first={run.run_id}&margin={0.01 + number / 1000}" for number in range(ASKING)]
        asked = [clients.submit(served.get, path, timeout=300) for path in paths]
        for path in ("/healthz", "/login", "/", "/runs", f"/runs/{run.run_id}", "/static/dashboard.css"):
            assert served.get(path, follow_redirects=False).status_code < 400, path
        assert not any(one.done() for one in asked)
        read.set()
        assert all("the disk is broken" in one.result().text for one in asked)


def test_a_known_comparison_is_shown_while_others_are_computed(tmp_path, slow_disk):
    ((_, run, _),) = fill(tmp_path, nights=1)
    address = f"/compare?first={run.run_id}"
    with serving(tmp_path) as served, ThreadPoolExecutor(1) as clients:
        slow_disk.set()
        assert served.get(address).status_code == 200
        slow_disk.clear()
        asked = clients.submit(served.get, f"{address}&margin=0.1")
        assert served.get(address).status_code == 200
        assert not asked.done()
        slow_disk.set()
        assert asked.result().status_code == 200


def test_a_leaderboard_does_not_wait_for_comparisons(tmp_path, slow_disk):
    ((_, run, _),) = fill(tmp_path, nights=1)
    with serving(tmp_path) as served, ThreadPoolExecutor(1) as clients:
        asked = clients.submit(served.get, f"/compare?first={run.run_id}")
        assert "merged" in served.get("/leaderboard?suite=nightly").text
        assert not asked.done()
        slow_disk.set()


def test_an_answer_is_sent_at_once():
    with listen("127.0.0.1", 0) as listening, socket.create_connection(listening.getsockname()):
        connection, _ = listening.accept()
        with connection:
            assert connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


def test_threads_that_compute_leave_the_interpreter_to_requests_soon(tmp_path):
    code = "import sys, uvicorn; uvicorn.Server.run = lambda *_, **__: print('interval', sys.getswitchinterval())\n"
    code += "from robogauntlet.orchestrator.cli import main; main()"
    history = file_url(tmp_path / "history.sqlite")
    done = run_process([sys.executable, "-c", code, "serve", "dashboard", "--port", "0", "--history", history])
    assert f"interval {SWITCH_S}" in done.stdout
    assert sys.getswitchinterval() > 2 * SWITCH_S


def test_a_signal_ends_the_dashboard_while_a_slow_answer_is_computed(tmp_path):
    ((_, run, _),) = fill(tmp_path, nights=1)
    code = "import time\nfrom robogauntlet.orchestrator.dashboard import compare\n"
    code += "def slow(*_):\n    print('computing', flush=True)\n    time.sleep(120)\n"
    code += "compare.open_entry = slow\nfrom robogauntlet.orchestrator.cli import main\nmain()"
    command = [
        sys.executable,
        "-c",
        code,
        "serve",
        "dashboard",
        "--port",
        "0",
        "--history",
        file_url(tmp_path / "history.sqlite"),
    ]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, env=environment_of(), **pipes) as server:
        try:
            address = urlsplit(server.stdout.readline().split()[1])
            with socket.create_connection((address.hostname, address.port)) as client:
                client.sendall(f"GET /compare?first={run.run_id} HTTP/1.1\r\nhost: {address.netloc}\r\n\r\n".encode())
                assert server.stdout.readline() == "computing\n"
                server.terminate()
                assert server.wait(60) == 0  # the answer takes 120 s
            assert "Traceback" not in server.stderr.read()
        finally:
            server.kill()


def test_runs_are_imported_again_after_any_error(tmp_path, monkeypatch):
    fill(tmp_path / "runs", nights=1)
    failed, really = threading.Event(), app_state.record_run_folders

    def record(*arguments):
        if not failed.is_set():
            failed.set()
            raise RecursionError("of one run")
        return really(*arguments)

    monkeypatch.setattr(app_state, "record_run_folders", record)
    monkeypatch.setattr(app_state, "SYNC_S", 0.05)
    (tmp_path / "runs/history.sqlite").unlink()
    with serving(tmp_path / "runs") as served:
        assert failed.wait(60)
        while not served.history.runs():
            threading.Event().wait(0.02)
