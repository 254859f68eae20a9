"""Processor time and memory of reports, comparisons, history and dashboard, with ten runs of 100,000 episodes."""

from __future__ import annotations

import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from studies.percent import few
from studies.shared import GAUNTLET, table_of

RUNS, EPISODES, ROUNDS = 10, few(100_000), 3
SUITE, SHARED = "nightly", ("oracle", "experts", "merged")
"""Each run has a policy of its own besides the shared ones, so that the leaderboard needs the rows of all."""
LATER = few(21)
"""Requests of a page after the first one."""
HISTORY = "history.sqlite"
CODE = """
import os, resource, sys
ended = os.waitpid(os.posix_spawn(sys.argv[1], sys.argv[1:], os.environ), 0)[1]
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024, os.waitstatus_to_exitcode(ended), file=sys.stderr)
"""
"""Starts a command and prints its processor time (s), largest memory (MiB) and exit code: a small process, since the
memory of the one that starts another counts as the other's."""


def measure() -> list[dict[str, object]]:
    """Fill ten run folders, then run the commands and request the pages of the dashboard on them."""
    with tempfile.TemporaryDirectory() as name:
        root, start = Path(name), time.perf_counter()
        filling = f"from studies.performance.million import fill; fill({name!r})"
        episodes = int(subprocess.run([sys.executable, "-c", filling], check=True, capture_output=True).stdout)
        print(f"{RUNS} runs of {episodes:,} episodes stored in {time.perf_counter() - start:.0f} s", flush=True)
        rows = [*_commands(root), *_pages(root)]
    columns = {"what": "{what}", "processor time, s": "{cpu_s:.2f}", "time, s": "{wall_s:.2f}"}
    table_of(rows, columns | {"memory, MiB": "{memory_mib:,.0f}", "asked again, ms": "{again}"})
    return rows


def _commands(root: Path) -> list[dict[str, object]]:
    last, before = (_name(RUNS - number) for number in (1, 2))
    words: dict[str, tuple[str, ...]] = {
        "`list runs`, which records the ten": ("list", "runs"),
        "`list runs`": ("list", "runs"),
        "`list runs merged`": ("list", "runs", "merged"),
        "`report RUN`": ("report", last),
        "`compare RUN`, four policies": ("compare", last),
        "`compare RUN:merged RUN:experts`": ("compare", f"{last}:merged", f"{last}:experts"),
        "`compare RUN OTHER`": ("compare", last, before, "--allow", "suite"),
        "`compare RUN --gate`": ("compare", last, "--gate", "--allow", "suite"),
        f"`compare --all {SUITE}`, 13 policies": ("compare", "--all", SUITE),
    }
    rows = []
    for what, arguments in words.items():
        taken = []
        for _ in range(ROUNDS):
            if "records" in what:
                for file in root.glob(f"{HISTORY}*"):
                    file.unlink()
            taken.append(_command(root, arguments))
        medians = {key: statistics.median(one[key] for one in taken) for key in taken[0]}
        rows.append({"what": what, **medians, "again": "-"})
    return rows


def _command(root: Path, arguments: tuple[str, ...]) -> dict[str, float]:
    """Processor time (s), time (s) and largest memory (MiB) of `robogauntlet ARGUMENTS`."""
    variables = os.environ | {"ROBOGAUNTLET_HISTORY": f"sqlite:///{root / HISTORY}"}
    command, start = [sys.executable, "-c", CODE, *GAUNTLET, *arguments], time.perf_counter()
    done = subprocess.run(command, cwd=root, env=variables, capture_output=True, text=True)
    wall_s = time.perf_counter() - start
    cpu_s, memory_mib, code = map(float, done.stderr.splitlines()[-1].split())
    if code not in (0, 1):  # 1: the gate found a regression
        raise SystemExit(done.stderr)
    return {"cpu_s": cpu_s, "wall_s": wall_s, "memory_mib": memory_mib}


def _pages(root: Path) -> list[dict[str, object]]:
    """Pages of the dashboard, each for the first time and again."""
    import httpx2
    import psutil

    command = [*GAUNTLET, "serve", "dashboard", "--port", "0", "--history", f"sqlite:///{root / HISTORY}"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=root)
    last, before = (f"{RUNS - number:032x}" for number in (1, 2))
    pages = (
        *("/", "/runs", f"/runs/{last}", f"/history?policy=merged&suite={SUITE}", f"/leaderboard?suite={SUITE}"),
        *(f"/compare?first={last}", f"/compare?first={last}&second={before}", "/failures", "/metrics"),
    )
    try:
        assert server.stdout is not None
        client = httpx2.Client(base_url=server.stdout.readline().split()[1], trust_env=False, timeout=600)
        client.get("/healthz").raise_for_status()
        return [_page(client, psutil.Process(server.pid), path) for path in pages]
    finally:
        server.terminate()
        server.wait(30)


def _page(client: Any, server: Any, path: str) -> dict[str, object]:
    files = Path(f"/proc/{server.pid}")
    (files / "clear_refs").write_text("5")  # the largest memory is that from now on
    used, start = sum(server.cpu_times()[:2]), time.perf_counter()
    client.get(path).raise_for_status()
    wall_s, cpu_s = time.perf_counter() - start, sum(server.cpu_times()[:2]) - used
    peak = re.search(r"VmHWM:\s+(\d+) kB", (files / "status").read_text())
    assert peak is not None
    times = []
    for _ in range(LATER):
        start = time.perf_counter()
        client.get(path).raise_for_status()
        times.append(1000 * (time.perf_counter() - start))
    what = f"page `{re.sub('[0-9a-f]{32}', 'ID', path)}`"
    taken = {"cpu_s": cpu_s, "wall_s": wall_s, "memory_mib": int(peak[1]) / 1024}
    return {"what": what, **taken, "again": f"{statistics.median(times):.0f}"}


def _name(number: int) -> str:
    return f"{SUITE}-{number:02}"


def fill(folder: str) -> None:
    """Make run folders of four policies, nine tasks in three simulators, and all axes; print the episodes of each."""
    from robogauntlet.suites.axes import AXES
    from robogauntlet.suites.episode import CONTROLS, Condition
    from robogauntlet.suites.schema import CompareEntry
    from tests.results.synthetic import cells, document, run_folder

    simulators = ("maniskill", "pybullet", "robosuite")
    tasks = tuple(f"{name}/Task{number}" for name in simulators for number in range(3))
    axes = [name for name, axis in AXES.items() if name not in CONTROLS]
    conditions: tuple[Condition, ...] = (Condition(), Condition("blind", 1), Condition("again", 1))
    conditions += tuple(Condition(name, severity) for name in axes for severity in (2, 4))
    for number in range(RUNS):
        plan = cells((*SHARED, f"candidate-{number}"), tasks, conditions)
        seeds, started_at = -(-EPISODES // len(plan)), 1_760_000_000.0 + 86_400 * number
        keys: Mapping[str, Any] = {
            "run_id": f"{number:032x}",
            "name": SUITE,
            "started_at": started_at,
            "finished_at": started_at + 36_000,
            "oracle_gate": "oracle",
            "compare": CompareEntry(baseline="experts", others=("merged", f"candidate-{number}")),
        }
        run_folder(Path(folder) / _name(number), document(seeds, of=plan, **keys), _rows(plan, seeds, number))
    print(seeds * len(plan))


def _rows(plan: Any, seeds: int, number: int) -> Any:
    """Rows with measured delivery, behaviour and routing, a cell after the other."""
    import numpy as np

    from tests.results.synthetic import row, with_behaviour

    generator = np.random.default_rng(number)
    for cell in plan:
        rate = 1.0 if cell.policy == "oracle" else 0.9 - 0.1 * cell.condition.severity
        won = generator.random(seeds) < rate
        routed = {"inferred_task": cell.task} if cell.policy == "merged" else {}
        outcomes = ("success" if one else "failure" for one in won)
        yield from with_behaviour(row(cell, n, one, delivered=1.0, **routed) for n, one in enumerate(outcomes))
