"""The store on a real PostgreSQL server, which this file starts and stops."""

import os
import pwd
import shutil
import socket
import subprocess
import tempfile
from pathlib import Path

import pytest

from robogauntlet.results.run_document import RunError, store_url
from robogauntlet.results.store.episode_store import Store, StoreError
from robogauntlet.results.store.run_history import History
from tests.results.synthetic import document, rows

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
    store = Store.open(server, "run-1")
    History(store.database).record(document(4, run_id="run-1"))
    results = rows(planned=4, errors=1)
    assert store.add(results) == len(results)
    assert store.add(results) == 0
    assert sorted(store.results(), key=lambda r: r.episode_id) == sorted(results, key=lambda r: r.episode_id)
    assert sum(map(len, store.outcomes().values())) == len(results)
    assert store.find(results[0].episode_id) == results[0]
    store.close()


def test_runs_share_a_database_without_seeing_each_other(server):
    results = rows(planned=2)
    for run_id in ("run-2", "run-3"):
        store = Store.open(server, run_id)
        History(store.database).record(document(2, run_id=run_id))
        assert store.add(results) == len(results)
        store.close()
    store = Store.open(server, "run-2")
    assert len(list(store.results())) == len(results)
    assert store.forget_errors() == sum(r.status == "error" for r in results)
    store.close()


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


def test_an_unreachable_server_is_one_line_without_the_password():
    with pytest.raises(StoreError) as caught:
        Store.open("postgresql+psycopg://tester:secret@127.0.0.1:1/postgres", "run")
    assert "\n" not in str(caught.value)
    assert "secret" not in str(caught.value)
    assert "127.0.0.1:1" in str(caught.value)


def test_a_run_with_rows_in_a_database_asks_for_its_url(tmp_path):
    run = document(3).model_copy(update={"store_url": "postgresql+psycopg://tester:***@127.0.0.1/postgres"})
    with pytest.raises(RunError, match=r"its rows are in postgresql.*; give that address with --store"):
        store_url(tmp_path, run)


@pytest.mark.ray
def test_a_whole_run_into_postgresql(server, tmp_path):
    import json
    import sys

    suite = tmp_path / "suite.yaml"
    suite.write_text("name: nulls\npolicies: [oracle, random]\ntasks: [null/Reach]\nseeds: {count: 10}\n")
    command = [
        sys.executable,
        "-c",
        "from robogauntlet.orchestrator.cli import main; main()",
        "run",
        suite,
        "--out",
        tmp_path / "run",
    ]
    done = subprocess.run([*command, "--store", server, "--no-media"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["total"]["done"] == 20
    everything = "".join(
        path.read_text() for path in (tmp_path / "run").iterdir() if path.suffix in (".json", ".md", ".html")
    )
    assert "secret" not in everything + done.stdout + done.stderr
