"""Asks a simulator, in a process of its own, whether it works here: a driver that crashes takes only that along."""

from __future__ import annotations

import contextlib
import io
import json
import os
import subprocess
import sys
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass

from adapters import catalog
from orchestrator.environments.homes import Homes
from orchestrator.runner import EpisodeRunner
from suites.vocabulary import CAMERAS, View

TIME_LIMIT_S = 240.0
_MARK = "robogauntlet-probe:"


@dataclass(frozen=True)
class Finding:
    """What a probe found."""

    simulator: str
    versions: dict[str, str]
    problem: str | None
    """Why it does not work, with the fix, or None."""
    render_device: str = ""
    frame_ms: float | None = None
    """Time of one warm observation by one camera (ms)."""


def probe(simulators: Iterable[str], homes: Homes | None = None) -> list[Finding]:
    """Probe simulators, two at a time.

    Args:
        simulators: Their names.
        homes: In which environment each of them runs.
    """
    homes = homes or Homes()
    with ThreadPoolExecutor(max_workers=2) as pool:
        return list(pool.map(lambda name: _probe_one(name, homes), simulators))


def _probe_one(name: str, homes: Homes) -> Finding:
    simulator = catalog.find(name)
    versions = homes.versions(simulator)
    missing = homes.missing_reason(simulator)
    if missing:
        return Finding(name, versions, missing)
    python, environment = homes.child(simulator)
    command = [python, "-m", "orchestrator.probe", name]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=TIME_LIMIT_S, env=environment, check=False
        )
    except subprocess.TimeoutExpired:
        return Finding(name, versions, f"did not open within {TIME_LIMIT_S:g} s")
    answer = next((line for line in done.stdout.splitlines() if line.startswith(_MARK)), None)
    if answer is None:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        return Finding(name, versions, f"the process that opened it ended with code {done.returncode}: {last}")
    return Finding(name, versions, **json.loads(answer.removeprefix(_MARK)))


def _open_and_look(name: str) -> dict[str, object]:
    simulator = catalog.find(name)
    runner = EpisodeRunner({})
    try:
        task = next(iter(simulator.tasks))
        found = asdict(runner.prepare(f"{name}/{task}", View(CAMERAS[:1])))
    except Exception as error:  # a missing driver shows as any exception
        lines = str(error).strip().splitlines() or ["no message"]
        return {"problem": f"{type(error).__name__}: {lines[0]}"}
    finally:
        runner.close()
    frame_s = found["frame_s"]
    return {"problem": None, "render_device": found["render_device"], "frame_ms": frame_s and round(1000 * frame_s, 1)}


if __name__ == "__main__":
    with contextlib.redirect_stdout(io.StringIO()):
        answer = _open_and_look(sys.argv[1])
    print(_MARK + json.dumps(answer), flush=True)
    os._exit(0)
