"""Duration of a run while fifty people watch it in the dashboard, compared with the same run unwatched."""

import os
import random
import subprocess
import tempfile
import threading
import time
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import psutil

from studies.percent import few
from studies.shared import GAUNTLET, duration_s, stored_rows, table_of

SUITE = """
name: watched
policies: [random]
tasks: [pybullet/PandaPush-v3, robosuite/Lift]
seeds: {count: 60}
workers: 1
render_profile: fast
"""
READERS, POLL_S, PAGES = 50, 2.0, ("/", "/runs", "/schedule", "/history?policy=random")
PAIRS = few(3, 1)


def measure() -> list[dict[str, object]]:
    """Alternate watched and unwatched runs, and compare them in pairs."""
    rows: list[dict[str, object]] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "suite.yaml").write_text(SUITE, encoding="utf-8")
        environment = {**os.environ, "ROBOGAUNTLET_HISTORY": f"sqlite:///{folder / 'history.sqlite'}"}
        _play(folder, environment, "warm-up")
        for pair in range(PAIRS):
            alone = _play(folder, environment, f"alone-{pair}")
            command = [*GAUNTLET, "serve", "dashboard", "--port", "0"]
            server = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True, cwd=folder)
            assert server.stdout is not None
            address = server.stdout.readline().split()[1].rstrip("/")
            over, answers, errors = threading.Event(), [0], [0]
            serving, began = psutil.Process(server.pid), time.perf_counter()
            before = sum(serving.cpu_times()[:2])
            with ThreadPoolExecutor(READERS) as readers:
                for number in range(READERS):
                    readers.submit(_read, address, number, over, answers, errors)
                try:
                    watched = _play(folder, environment, f"watched-{pair}")
                finally:
                    over.set()
            used = sum(serving.cpu_times()[:2]) - before
            share = used / (time.perf_counter() - began) / len(os.sched_getaffinity(0))
            server.terminate()
            server.wait()
            row = {"pair": pair + 1, "alone_s": alone, "watched_s": watched, "ratio": watched / alone, "server": share}
            rows.append({**row, "answers": answers[0], "errors": errors[0]})
    columns = {"pair": "{pair}", "alone (s)": "{alone_s:.1f}", f"watched by {READERS} (s)": "{watched_s:.1f}"}
    columns |= {"ratio": "{ratio:.3f}", "server, of all cores": "{server:.1%}"}
    table_of(rows, columns | {"answers": "{answers}", "errors": "{errors}"})
    return rows


def _play(folder: Path, environment: dict[str, str], name: str) -> float:
    """Run the suite into the folder `name`; return the duration of its episodes (s)."""
    command = [*GAUNTLET, "run", str(folder / "suite.yaml"), "--out", str(folder / name), "--no-media"]
    subprocess.run(command, check=True, capture_output=True, env=environment)
    return duration_s(stored_rows(folder / name))


def _read(address: str, number: int, over: threading.Event, answers: list[int], errors: list[int]) -> None:
    """Simulate a person with the overview open, who opens another page every ten polls."""
    generator = random.Random(number)
    time.sleep(generator.uniform(0, POLL_S))
    turn = 0
    while not over.wait(POLL_S):
        turn += 1
        page = generator.choice(PAGES) if turn % 10 == number % 10 else "/api/live"
        try:
            with urllib.request.urlopen(address + page, timeout=30) as answer:
                answer.read()
            answers[0] += 1
        except OSError:
            errors[0] += 1
