"""Overhead of a query to a policy in another process, with two 224 px cameras over loopback.

The policy answers immediately. The server is that of the command line, the client that of the workers.
"""

from __future__ import annotations

import os
import re
import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from robogauntlet.adapters.contract import Observation
from robogauntlet.policies import catalog
from robogauntlet.policies.contract import Query
from robogauntlet.suites.episode import Episode, Protocol, View
from studies.percent import few
from studies.shared import GAUNTLET, table_of

SIZE = 224
QUERIES, WARM = few(1000), few(50)
POLICY = """
import numpy as np

CHUNK = np.zeros((8, 7))

def act(images, proprioception, instruction):
    return CHUNK
"""


def measure() -> list[dict[str, object]]:
    """Median and 95th percentile of a query: in the process, and through a server with and without options."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "answers_at_once.py").write_text(POLICY)
        options = {"callable": "answers_at_once:act", "folder": name}
        rows = [_row("in the process", "python", options)]
        with _server(folder) as address:
            rows.append(_row("served", "openpi", {"address": address}))
            rows.append(_row("served, `execute: 8`", "openpi", {"address": address, "execute": 8}))
    local = float(str(rows[0]["median_ms"]))
    for row in rows:
        row["over_ms"] = float(str(row["median_ms"])) - local
    load = os.getloadavg()[0]
    print(f"{QUERIES} queries each; load of the machine {load:.1f} on {os.cpu_count()} cores")
    columns = {"policy": "{policy}", "median, ms": "{median_ms:.2f}", "95 %, ms": "{p95_ms:.2f}"}
    table_of(rows, columns | {"beyond the process, ms": "{over_ms:.2f}"})
    return [{**row, "load": load} for row in rows]


def _row(title: str, kind: str, options: Mapping[str, object]) -> dict[str, object]:
    policy = catalog.load(kind, options)
    generator = np.random.default_rng(0)
    images = {c: generator.integers(0, 256, (SIZE, SIZE, 3), dtype=np.uint8) for c in ("third_person", "wrist")}
    seen = Observation(images, np.zeros(8), "put the red cube on the green cube")
    episode = Episode("policy", "digest", "null/Reach", 0, Protocol(60, 8, View(image_size=SIZE)))
    policy.reset([episode])
    times = []
    for step in range(WARM + QUERIES):
        start = time.perf_counter()
        policy.act([Query(episode, step, seen)])
        times.append(1000 * (time.perf_counter() - start))
    median, p95 = np.percentile(times[WARM:], [50, 95])
    return {"policy": title, "median_ms": float(median), "p95_ms": float(p95)}


@contextmanager
def _server(folder: Path) -> Iterator[str]:
    arguments = ["serve", "policy", "python:answers_at_once:act", "--option", f"folder={folder}", "--port", "0"]
    process = subprocess.Popen([*GAUNTLET, *arguments], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        found = re.search(r"ws://\S+?:\d+", process.stdout.readline())
        assert found, "the server did not start"
        yield found[0]
    finally:
        process.terminate()
        process.wait(10)
