"""Kills the schedule server repeatedly: `python -m tests.chaos.schedules --kills 100`."""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from robogauntlet.orchestrator.schedules.schedule import Schedule, State
from robogauntlet.orchestrator.schedules.server import Server
from robogauntlet.orchestrator.schedules.store import ScheduleStore
from robogauntlet.results.run_document import RunStatus, read_run
from robogauntlet.results.store.database import file_url
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.run_history import History

SERVE = [sys.executable, "-c", "from robogauntlet.orchestrator.cli import main; main()", "schedule", "serve"]
STOP_TIMEOUT_S = 300.0


def serve_and_kill(url: str, kills: int, done: Callable[[], bool], seed: int = 5) -> int:
    """Run the schedule server until `done`, and kill it up to `kills` times; return how often it was killed."""
    environment, generator = {**os.environ, "ROBOGAUNTLET_HISTORY": url}, random.Random(seed)
    killed = 0
    while not done():
        process = subprocess.Popen(SERVE, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        lifetime_s = generator.uniform(0.5, 6.0) if killed < kills else STOP_TIMEOUT_S
        until = time.monotonic() + lifetime_s
        while time.monotonic() < until and not done():
            time.sleep(0.1)
        process.send_signal(signal.SIGKILL)
        process.wait()
        if killed == kills:
            break
        killed += 1
    return killed


def played(root: Path, history: History) -> dict[str, int]:
    """Folder of each run to its number of rows, or -1 if it is incomplete. Each may be in the history only once."""
    folders = [entry.name for entry in history.runs()]
    assert len(folders) == len(set(folders))
    rows = {}
    for name in folders:
        run = read_run(root / name)
        store = Store.open_file(root / name / "episodes.sqlite", run.run_id)
        rows[name] = len(list(store.results())) if run.status is RunStatus.COMPLETE else -1
        store.close()
    return rows


def main() -> None:
    """Trigger runs, kill servers, and count the runs and rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--runs", type=int, default=20)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "runs"
        root.mkdir()
        url = file_url(root / "history.sqlite")
        suite = Path(folder) / "nights.yaml"
        suite.write_text("name: nights\npolicies: [oracle]\ntasks: [null/Reach]\nseeds: {count: 40}\n")
        schedule_store, history = ScheduleStore.open(url), History.open(url)
        schedule = Schedule("nightly", str(suite), "0 0 1 1 *", arguments=("--no-media",), created_at=time.time())
        schedule_store.add(schedule)
        server = Server(schedule_store, history, root, send=print, log=print)
        for number in range(options.runs):
            schedule_store.trigger_now(schedule, time.time() + number, server.folder)
        killed = serve_and_kill(
            url, options.kills, lambda: all(f.state is State.DONE for f in schedule_store.scheduled_runs())
        )
        states = sorted(str(scheduled_run.state) for scheduled_run in schedule_store.scheduled_runs())
        rows = played(root, history)
        whole = sum(count == 40 for count in rows.values())
        print(f"{killed} kills: {states.count('done')} of {options.runs} runs done, {whole} complete runs of 40 rows,")
        print(f"{options.runs - whole} lost, {len(rows) - options.runs} more than were triggered")
        schedule_store.close()
        history.close()
        sys.exit(whole != options.runs or len(rows) != options.runs)


if __name__ == "__main__":
    main()
