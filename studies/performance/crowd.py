"""Response times of the dashboard (ms) and its memory (MB) while twenty hostile clients upload, compare and stall."""

from __future__ import annotations

import itertools
import os
import tempfile
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from studies.shared import table, table_of
from tests.orchestrator.dashboard.crowd import BEARER, Crowd, Server, exported_run, served_by_process

NIGHTS, SECONDS, MB = 300, 60.0, 1e6
RECORDED, LARGEST, UPLOADED = 20, 1000, 100
"""Episodes of each of the 15 cells of a recorded run, of the largest one and of an uploaded one."""
LIMIT = 256 * 1024 * 1024
"""Largest upload, the default of `robogauntlet serve` (bytes)."""
NEW = "`/compare?policies=ID`, a new one"
Answers = list[tuple[float, int]]
"""Time (ms) and status of each answer."""


def measure() -> list[dict[str, Any]]:
    """Fill a root, serve it, and request pages in turn: first alone, then beside the hostile clients."""
    with tempfile.TemporaryDirectory() as name:
        root = Path(name) / "runs"
        start = time.perf_counter()
        ids = _fill(root)
        print(f"{NIGHTS:,} runs stored in {time.perf_counter() - start:.0f} s", flush=True)
        run_id, exported = exported_run(Path(name) / "elsewhere", seeds=UPLOADED)
        pages = _pages(ids)
        with served_by_process(root) as server, ThreadPoolExecutor(1) as beside:
            crowd = Crowd(server.address, ids, run_id, exported, LIMIT)
            start_mb = server.memory / MB
            _request(server, pages, 0)  # once, as the first request of a page takes longer
            alone = _request(server, pages, SECONDS / 6)
            with crowd.attacking(SECONDS) as finish, _memory(server) as most:
                new = beside.submit(_request, server, {NEW: f"/compare?policies={ids[2]}&margin={{}}"}, SECONDS)
                answers = _request(server, pages, SECONDS) | new.result()
                got = finish()
    same = {"start_mb": start_mb, "most_mb": max(most) / MB, "load": os.getloadavg()[0]}
    rows = [_row(page, answers[page], alone.get(page, [])) | same for page in answers]
    rows.append(_row("all but the new comparison", _all(answers, pages), _all(alone, pages)) | same)
    rows[-1]["hostile"] = [[act, what, number] for (act, what), number in sorted(got.items())]
    table(("hostile clients", "got", "times"), rows[-1]["hostile"])
    print("memory: {start_mb:.0f} MB at the start, {most_mb:.0f} MB at most; load {load:.1f}".format(**same))
    columns = {"page": "{page}", "requests": "{requests:,}", "refused": "{refused}", "alone, median, ms": "{alone}"}
    columns |= {"median, ms": "{median_ms:.0f}", "99 %, ms": "{p99_ms:.0f}", "worst, ms": "{worst_ms:.0f}"}
    table_of(rows, columns)
    return rows


def _fill(root: Path) -> tuple[str, ...]:
    """Record nights, a larger run and hostile ones; return the ids of those with rows, the largest first."""
    from robogauntlet.results.store.database import file_url
    from robogauntlet.results.store.history_import import record_run_folder
    from robogauntlet.results.store.run_history import History
    from tests.orchestrator.dashboard.conftest import NOW, fill
    from tests.orchestrator.dashboard.filled import DAY, nightly_run, record_hostile_runs

    made = fill(root, NIGHTS)
    folder, run, _ = nightly_run(root, NIGHTS, NOW + NIGHTS * DAY, seeds=LARGEST)
    with closing(History.open(file_url(root / "history.sqlite"))) as history:
        record_run_folder(history, folder, run)
        record_hostile_runs(history, root)
    return (run.run_id, *(run.run_id for _, run, _ in made))


def _pages(ids: tuple[str, ...]) -> dict[str, str]:
    """A page of each kind, and its address; the comparison is the same each time."""
    plain = ("/", "/api/live", "/runs", "/history?policy=merged", "/leaderboard?suite=nightly")
    plain += ("/failures", "/schedule", "/metrics", "/healthz")
    of_runs = {"`/runs/ID`": f"/runs/{ids[0]}", "`/compare?policies=ID`": f"/compare?policies={ids[1]}"}
    return {f"`{address}`": address for address in plain} | of_runs


@contextmanager
def _memory(server: Server) -> Iterator[list[int]]:
    """The memory of the server, several times a second during the block (bytes)."""
    found, over = [server.memory], threading.Event()

    def watch() -> None:
        while not over.wait(0.2):
            found.append(server.memory)

    thread = threading.Thread(target=watch)
    thread.start()
    try:
        yield found
    finally:
        over.set()
        thread.join()


def _request(server: Server, pages: dict[str, str], seconds: float) -> dict[str, Answers]:
    """Request all pages in turn, once or more; `{}` in an address is another margin each time."""
    import httpx2

    answers: dict[str, Answers] = {page: [] for page in pages}
    until = time.monotonic() + seconds
    with httpx2.Client(base_url=server.address, headers=BEARER, timeout=120, trust_env=False) as client:
        for turn in itertools.count(1):
            for page, address in pages.items():
                start = time.perf_counter()
                status = client.get(address.format(turn / 10_000)).status_code
                answers[page].append((1000 * (time.perf_counter() - start), status))
            if time.monotonic() > until:
                return answers
    raise AssertionError


def _all(answers: dict[str, Answers], pages: dict[str, str]) -> Answers:
    return [answer for page in pages for answer in answers[page]]


def _row(page: str, answers: Answers, alone: Answers) -> dict[str, Any]:
    """The figures of a page, beside the hostile clients and alone."""
    times = [time_ms for time_ms, _ in answers]
    return {
        "page": page,
        "requests": len(answers),
        "refused": sum(status != 200 for _, status in answers),
        "alone": f"{np.median([time_ms for time_ms, _ in alone]):.0f}" if alone else "",
        "median_ms": float(np.median(times)),
        "p99_ms": float(np.percentile(times, 99)),
        "worst_ms": max(times),
    }
