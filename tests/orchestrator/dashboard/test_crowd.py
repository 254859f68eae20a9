"""A dashboard that twenty hostile clients attack: `studies.performance.crowd` measures how fast it answers."""

import time
from contextlib import closing

import httpx2
import pytest

from robogauntlet.results.store.database import file_url
from robogauntlet.results.store.run_history import History
from tests.orchestrator.dashboard.conftest import fill
from tests.orchestrator.dashboard.crowd import BEARER, Crowd, exported_run, served_by_process
from tests.orchestrator.dashboard.filled import record_hostile_runs
from tests.orchestrator.dashboard.test_uploading import left_over

PATHS = ("/", "/api/live", "/runs", "/history?policy=merged", "/leaderboard?suite=nightly", "/compare", "/failures")
PATHS += ("/schedule", "/metrics", "/healthz")
SECONDS, TIMEOUT_S, MEMORY = 2.0, 60.0, 300_000_000
LIMIT_MB = 2


@pytest.mark.slow
def test_pages_are_answered_while_hostile_clients_upload_compare_and_stall(tmp_path):
    root = tmp_path / "runs"
    ids = tuple(run.run_id for _, run, _ in fill(root, nights=3))
    with closing(History.open(file_url(root / "history.sqlite"))) as history:
        record_hostile_runs(history, root)
    run_id, exported = exported_run(tmp_path / "elsewhere", seeds=2)
    client = httpx2.Client(headers=BEARER, timeout=TIMEOUT_S, trust_env=False)
    with served_by_process(root, "--max-upload-mb", str(LIMIT_MB)) as server, client:
        client.base_url, paths = server.address, (*PATHS, f"/runs/{ids[0]}", f"/compare?policies={ids[0]}")
        assert {path: client.get(path).status_code for path in paths} == dict.fromkeys(paths, 200)
        memory, until = [server.memory], time.monotonic() + SECONDS
        with Crowd(server.address, ids, run_id, exported, LIMIT_MB * 1024 * 1024).attacking(SECONDS) as finish:
            while time.monotonic() < until:
                for path in paths:
                    assert client.get(path).status_code == 200, path
                    memory.append(server.memory)
            got = finish()
        assert max(memory) - memory[0] < MEMORY
        stored = [folder for folder in root.glob("nightly-*") if len(folder.name) == len("nightly-01234567")]
        assert len(stored) == got["upload_a_run", "201"] > 0
        assert got["upload_rubbish", "400"] > 0
        while left_over(root):  # a server that ends does not wait for uploads
            time.sleep(0.05)
