"""Uploaded runs."""

import http.client
import json
import os
import sqlite3
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from urllib.parse import urlsplit

import pytest

from robogauntlet.results.run_document import store_url
from robogauntlet.results.store import limited_reader
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.exported_file import reading_time_s
from robogauntlet.results.store.run_archive import export_run
from tests.orchestrator.dashboard.conftest import serving
from tests.orchestrator.dashboard.filled import nightly_run
from tests.results.store.earlier import as_version_1
from tests.results.synthetic import document

LIMIT = 1_000_000


@pytest.fixture
def served(tmp_path):
    with serving(tmp_path / "runs", max_upload=LIMIT) as found:
        yield found


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """A run, and the file that it was exported into."""
    root = tmp_path_factory.mktemp("elsewhere")
    folder, run, _ = nightly_run(root, 7, 1_790_000_000.0, seeds=2)
    rows = Store.open(store_url(folder, run), run.run_id)
    export_run(run, rows, root / "run.robogauntlet")
    rows.close()
    return run, (root / "run.robogauntlet").read_bytes()


def left_over(root):
    return [path.name for path in root.iterdir() if path.name.startswith((".upload", ".arriving"))]


def test_an_uploaded_run_gets_a_folder_and_a_report(served, exported):
    run, body = exported
    answer = served.post("/runs", content=body)
    assert answer.status_code == 201
    assert answer.headers["location"] == f"/runs/{run.run_id}"
    assert answer.text == f"/runs/{run.run_id}\n"
    assert "30 of 30 episodes done" in served.get(answer.headers["location"]).text
    while served.get(f"/runs/{run.run_id}/files/report.html").status_code != 200:
        time.sleep(0.05)  # it is written after the answer
    assert left_over(served.root) == []


def test_an_uploaded_run_of_version_1_gets_a_folder(served, exported, tmp_path):
    run, body = exported
    file = tmp_path / "run.robogauntlet"
    file.write_bytes(body)
    answer = served.post("/runs", content=as_version_1(file).read_bytes())
    assert answer.status_code == 201
    assert "30 of 30 episodes done" in served.get(f"/runs/{run.run_id}").text


def test_an_existing_run_is_refused_and_unchanged(served, exported):
    run, body = exported
    served.history.record(document(run_id=run.run_id, name="mine"))
    answer = served.post("/runs", content=body)
    assert answer.status_code == 409
    assert answer.text == f"run {run.run_id} exists already\n"
    assert served.history.document(run.run_id).suite.name == "mine"
    assert not list(served.root.glob("*/run.json"))


@pytest.mark.parametrize(
    "body",
    [b"", b"hello", b"SQLite format 3\0", b"SQLite format 3\0" + b"x" * 9000],
    ids=["empty", "text", "head", "torn"],
)
def test_a_body_that_is_no_run_is_refused_in_one_line(served, body):
    answer = served.post("/runs", content=body)
    assert answer.status_code == 400
    assert len(answer.text.splitlines()) == 1
    assert "expected an exported run" in answer.text
    assert str(served.root) not in answer.text
    assert left_over(served.root) == []


@pytest.mark.parametrize(
    ("forged", "words"),
    [
        ({"rows_hash": "0" * 16}, "it was changed"),
        ({"run_id": "../<script>"}, "its run id is not one of this program"),
        ({"store_url": "sqlite:////etc/passwd"}, "its rows are in another store"),
        ({"started_at": 1e20}, "started_at"),
        ({"media_left_out": 2**63}, "media_left_out"),
        ({"plan": "all"}, "plan"),
    ],
)
def test_a_run_that_this_program_did_not_write_is_refused(served, tmp_path, exported, forged, words):
    file = tmp_path / "forged.robogauntlet"
    file.write_bytes(exported[1])
    with sqlite3.connect(file) as connection:
        text = json.loads(connection.execute("SELECT document FROM runs").fetchone()[0]) | forged
        connection.execute("UPDATE runs SET document = ?", [json.dumps(text)])
    connection.close()
    answer = served.post("/runs", content=file.read_bytes())
    assert answer.status_code == 400
    assert words in answer.text
    assert served.history.runs() == []
    assert list(served.root.glob("*/run.json")) == left_over(served.root) == []


def instead_of_reading(monkeypatch, code):
    """Start a process of this code where an upload is read."""
    code = f"import os, sys, time\nsys.stdin.readline()\n{code}"
    monkeypatch.setattr(limited_reader, "COMMAND", (sys.executable, "-c", code))


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("os.kill(os.getpid(), 11)", "it cannot be read: the process was killed by SIGSEGV"),
        ("raise MemoryError", "reading it takes too much memory"),
        ("raise TypeError('/etc/passwd')", "it cannot be read: the process ended with code 1"),
    ],
)
def test_an_upload_that_breaks_its_reader_is_refused_and_the_next_is_taken(served, exported, monkeypatch, code, words):
    with monkeypatch.context() as patch:
        instead_of_reading(patch, code)
        answer = served.post("/runs", content=exported[1])
    assert (answer.status_code, answer.text) == (
        400,
        f"the body: expected an exported run (`robogauntlet export`), {words}\n",
    )
    assert list(served.root.glob("*/run.json")) == left_over(served.root) == []
    assert served.post("/runs", content=exported[1]).status_code == 201


def test_the_dashboard_answers_while_an_upload_is_read_for_ever(served, exported, monkeypatch):
    monkeypatch.setattr(limited_reader, "START_S", 5.0 - reading_time_s(0))
    instead_of_reading(monkeypatch, "time.sleep(600)")
    with ThreadPoolExecutor(1) as pool:
        upload = pool.submit(served.post, "/runs", content=exported[1])
        answered = 0
        while not upload.done():
            answered += served.get("/").status_code == 200
            time.sleep(0.1)
    assert answered > 3
    assert upload.result().status_code == 400
    assert upload.result().text.endswith("reading it takes too long\n")
    assert left_over(served.root) == []


def test_a_too_large_upload_is_refused_by_its_length(served):
    answer = served.post("/runs", content=b"x" * (LIMIT + 1))
    assert answer.status_code == 413
    assert "--max-upload-mb" in answer.text


def test_a_too_large_upload_without_a_length_is_refused(served):
    answer = served.post("/runs", content=(b"x" * 100_000 for _ in range(11)))
    assert answer.status_code == 413
    assert left_over(served.root) == []


def begin_upload(served, body, length):
    connection = http.client.HTTPConnection(urlsplit(served.address).netloc, timeout=30)
    connection.putrequest("POST", "/runs")
    connection.putheader("Content-Length", str(length))
    connection.endheaders(body)
    return connection


def test_a_wrong_length_admits_no_larger_upload(served):
    connection = begin_upload(served, b"x" * 5000, length=10)
    assert connection.getresponse().status == 400  # fewer bytes than its length
    connection.close()
    assert left_over(served.root) == []


def test_an_aborted_upload_leaves_nothing(served):
    connection = begin_upload(served, b"SQLite format 3\0", length=500_000)
    while not left_over(served.root):
        time.sleep(0.01)
    connection.close()
    while left_over(served.root):
        time.sleep(0.01)


def test_what_a_dead_server_left_of_uploads_is_removed(tmp_path):
    abandoned = tmp_path / "runs" / ".arriving-dead"
    abandoned.mkdir(parents=True)
    (abandoned / "body").write_bytes(b"x" * 1000)
    os.utime(abandoned, (1.0, 1.0))
    with serving(tmp_path / "runs"):
        while abandoned.exists():
            time.sleep(0.01)
