"""From nothing to a table of a user's function, to the first row in a running process, and to the check of a policy."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

import robogauntlet
from robogauntlet.results.run_document import read_run
from robogauntlet.results.store.episode_store import Store
from studies.shared import table_of
from studies.tables import ROOT

TIMES = 3
TASK = "pybullet/PandaReach-v3"
LINES = f'''import numpy as np
import robogauntlet
def act(images, proprioception, instruction):
    return np.zeros((8, 7))
run = robogauntlet.evaluate(act, "{TASK}", seeds=10)
print(run)
'''


def measure() -> list[dict[str, Any]]:
    """Time each, the last two several times."""
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        wheel = _wheel(folder)
        python = folder / "environment" / "bin" / "python"
        rows.append(_row("install the wheel with the extra `pybullet`", lambda: _install(python, wheel)))
        (folder / "six_lines.py").write_text(LINES)
        rows.append(_row("six lines: 10 episodes of an own function", lambda: _run([python, "six_lines.py"], folder)))
        rows.append(_row("`evaluate` in a running process: its first row", lambda: _first_row(folder), TIMES))
        command = [python.with_name("robogauntlet"), "check", "policy", "python:mine:act"]
        (folder / "mine.py").write_text("\n".join(LINES.splitlines()[:4]))
        rows.append(_row("`robogauntlet check policy` of it", lambda: _run(command, folder), TIMES))
    table_of(
        rows, {"step": "{step}", "times": "{times}", "median, s": "{median_s:.1f}", "longest, s": "{longest_s:.1f}"}
    )
    return rows


def _row(step: str, run: Callable[[], float | None], times: int = 1) -> dict[str, Any]:
    """Seconds of a step, as it returns them or else from outside."""
    found = []
    for _ in range(times):
        began = time.perf_counter()
        own = run()
        found.append(time.perf_counter() - began if own is None else own)
    return {"step": step, "times": times, "median_s": median(found), "longest_s": max(found)}


def _wheel(folder: Path) -> Path:
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    _run([*build, "--wheel-dir", folder / "dist", ROOT], ROOT)
    return next((folder / "dist").glob("robogauntlet-*.whl"))


def _install(python: Path, wheel: Path) -> None:
    venv.create(python.parents[1], with_pip=True)
    options = ["--quiet", "--no-cache-dir", "-c", ROOT / "constraints.txt"]
    _run([python, "-m", "pip", "install", *options, f"robogauntlet[pybullet] @ {wheel.as_uri()}"], ROOT)


def _still(images: Any, proprioception: Any, instruction: str) -> Any:
    return np.zeros((8, 7))


def _first_row(folder: Path) -> float:
    """Seconds from the call to the end of the first episode."""
    out = Path(tempfile.mkdtemp(dir=folder))
    began = time.time()
    robogauntlet.evaluate(_still, TASK, seeds=1, out=out / "run", quiet=True)
    document = read_run(out / "run")
    store = Store.open_file(out / "run" / "episodes.sqlite", document.run_id)
    try:
        return min(row.started_at + row.wall_s for row in store.results()) - began
    finally:
        store.close()


def _run(command: list[Any], folder: Path) -> None:
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    subprocess.run([*map(str, command)], cwd=folder, env=environment, check=True, stdout=subprocess.DEVNULL)
