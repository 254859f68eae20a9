"""The store on a real PostgreSQL server, which this file starts and stops."""

import json
import os
import pwd
import shutil
import socket
import subprocess
import sys
import tempfile
from contextlib import closing
from pathlib import Path

import pytest

from robogauntlet.results.store.database import UnstorableValue
from robogauntlet.results.store.episode_store import Store, StoreError
from robogauntlet.results.store.run_history import History
from tests.errors import one_line_error
from tests.results.synthetic import cells, document, row, rows

pytestmark = pytest.mark.slow
FOLDERS = [*sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True), Path(shutil.which("pg_ctl") or "/").parent]
PROGRAMS = next((folder for folder in FOLDERS if (folder / "pg_ctl").exists()), None)


def as_postgres():
    """PostgreSQL refuses to run as root: run its programs as the user its package made."""
    if os.geteuid() != 0:
        return {}
    try:
        user = pwd.getpwnam("postgres")
    except KeyError:
        pytest.skip("no user postgres to run the server as")
    return {"user": user.pw_uid, "group": user.pw_gid, "extra_groups": []}


@pytest.fixture(scope="module")
def server():
    if PROGRAMS is None:
        pytest.skip("no PostgreSQL server installed: sudo apt-get install postgresql")
    who = as_postgres()
    # Not in pytest's own folder: each pytest that starts on this machine shuts that to other users, the server's too.
    folder = Path(tempfile.mkdtemp(prefix="postgresql-"))
    folder.chmod(0o755)
    if who:
        os.chown(folder, who["user"], who["group"])
    data = folder / "data"
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]

    def call(*command):
        subprocess.run(command, check=True, capture_output=True, timeout=120, cwd=folder, **who)

    call(PROGRAMS / "initdb", "-D", data, "-A", "trust", "-U", "tester", "--no-sync", "-E", "UTF8")
    options = f"-c listen_addresses=127.0.0.1 -c port={port} -c unix_socket_directories={folder} -c fsync=off"
    call(PROGRAMS / "pg_ctl", "-D", data, "-o", options, "-w", "-l", folder / "log", "start")
    yield f"postgresql+psycopg://tester:secret@127.0.0.1:{port}/postgres"
    call(PROGRAMS / "pg_ctl", "-D", data, "-m", "immediate", "-w", "stop")
    shutil.rmtree(folder)


def test_rows_are_stored_once_and_come_back_as_they_were(server):
    results = rows(planned=4, errors=1)
    with closing(Store.open(server, "run-1")) as store:
        History(store.database).record(document(4, run_id="run-1"))
        assert store.add(results) == len(results)
        assert store.add(results) == 0
        assert sorted(store.results(), key=lambda r: r.episode_id) == sorted(results, key=lambda r: r.episode_id)
        assert sum(map(len, store.outcomes().values())) == len(results)
        assert store.find(results[0].episode_id) == results[0]


def test_runs_share_a_database_without_seeing_each_other(server):
    results = rows(planned=2)
    for run_id in ("run-2", "run-3"):
        with closing(Store.open(server, run_id)) as store:
            History(store.database).record(document(2, run_id=run_id))
            assert store.add(results) == len(results)
    with closing(Store.open(server, "run-2")) as store:
        assert len(list(store.results())) == len(results)
        assert store.forget_errors() == sum(r.status == "error" for r in results)


def test_the_history_stores_counts_and_verdicts(server):
    history, run = History.open(server), document(3, run_id="run-4", name="kept")
    history.record(run)
    store = Store.open(server, "run-4")
    store.add(rows(planned=3, errors=1))
    history.record(run, Path("/somewhere/night"), history.count_cells("run-4"), "nightly")
    (entry,) = history.runs(suite="kept")
    assert (entry.name, entry.schedule, entry.counts.planned) == ("night", "nightly", run.planned)
    assert entry.counts.done == len(rows(planned=3))
    history.write_verdict("run-4", "regressed", "run-3", ["worse"])
    assert history.find("night").verdict == "regressed"
    assert [night.counts.done for night in history.policy_history("oracle", suite="kept")] == [12]
    later = document(3, run_id="run-5", name="kept", started_at=run.started_at + 1)
    assert history.baseline(later) is None
    history.accept("run-4")
    assert history.baseline(later).run_id == "run-4"
    store.close()
    history.close()


def test_imported_and_forgotten_runs_are_kept_apart(server):
    with closing(History.open(server)) as history:
        history.record(document(2, run_id="run-6", name="sent", origin="imported"))
        with closing(Store.open(server, "run-6")) as store:
            store.add(rows(planned=2))
        (entry,) = history.runs(suite="sent")
        assert entry.imported
        later = document(2, run_id="run-7", name="sent", started_at=entry.started_at + 1)
        assert history.baseline(later) is None
        history.accept("run-6")
        assert history.baseline(later) is None
        assert history.forget("run-6", "/somewhere/sent") == len(rows(planned=2))
        assert history.forgotten_folders() == {"/somewhere/sent": "run-6"}
        assert history.runs(suite="sent") == []
        history.record(document(2, run_id="run-6", name="sent"))
        assert history.forgotten_folders() == {}


@pytest.mark.parametrize("change", [{"steps": 2**63}, {"error": "a\0b"}, {"error": "\ud800"}], ids=repr)
def test_a_value_that_postgresql_does_not_hold_is_one_line(server, change):
    with closing(Store.open(server, "run-8")) as store:
        History(store.database).record(document(1, run_id="run-8"))
        with one_line_error(UnstorableValue):
            store.add([row(cells()[0], 0, **change)])
        assert list(store.results()) == []


def test_an_unreachable_server_is_one_line_without_the_password():
    with one_line_error(StoreError, "127.0.0.1:1") as caught:
        Store.open("postgresql+psycopg://tester:secret@127.0.0.1:1/postgres", "run")
    assert "secret" not in str(caught.value)


@pytest.mark.nightly
@pytest.mark.ray
def test_a_whole_run_into_postgresql(server, tmp_path):
    suite = tmp_path / "suite.yaml"
    suite.write_text("name: nulls\npolicies: [oracle, random]\ntasks: [null/Reach]\nseeds: {count: 10}\n")
    program = [sys.executable, "-c", "from robogauntlet.orchestrator.cli import main; main()"]
    options = ["--out", tmp_path / "run", "--store", server, "--no-media"]
    done = subprocess.run([*program, "run", suite, *options], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["total"]["done"] == 20
    texts = [path.read_text() for path in (tmp_path / "run").iterdir() if path.suffix in (".json", ".md", ".html")]
    assert not any("secret" in text for text in [*texts, done.stdout, done.stderr])
