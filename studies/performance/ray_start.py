"""A start of Ray and of a worker on one machine, as runs do it; each in a new process."""

import json
import subprocess
import sys
from statistics import median

from studies.percent import few
from studies.shared import table_of
from studies.tables import ROOT
from tests.processes import environment_of

TIMES = 5
CODE = """
import json, os, time
import psutil, ray
from robogauntlet.orchestrator.ray_runtime import session

start = time.perf_counter()
with session.ray_session(address=None, workers=1):
    up = time.perf_counter() - start
    time.sleep(4.0)  # all have been imported
    parts = psutil.Process().children(recursive=True)
    spent = sum(sum(part.cpu_times()[:2]) for part in parts)
    memory = sum(part.memory_info().rss for part in parts) / 1e6
    begin = time.perf_counter()
    worker = ray.remote(num_cpus=0)(lambda: sum(os.times()[:2]))
    result = {"worker": ray.get(worker.remote()), "worker_up": time.perf_counter() - begin}
    end = time.perf_counter()
result |= {"up": up, "down": time.perf_counter() - end, "spent": spent, "memory": memory, "parts": len(parts)}
print(json.dumps(result))
"""


def measure() -> list[dict[str, object]]:
    """Medians: seconds until Ray and a worker are up and Ray is down; processor time (s), memory (MB), processes."""
    starts: list[dict[str, float]] = []
    for _ in range(few(TIMES)):
        command = [sys.executable, "-c", CODE]
        done = subprocess.run(command, env=environment_of(ROOT), stdout=subprocess.PIPE, text=True, check=True)
        starts.append(json.loads(done.stdout.splitlines()[-1]))
    rows: list[dict[str, object]] = [{name: median(one[name] for one in starts) for name in starts[0]}]
    columns = {"processes": "{parts:.0f}", "processor time, s": "{spent:.2f}"}
    columns |= {"memory, MB": "{memory:.0f}", "up, s": "{up:.1f}", "down, s": "{down:.1f}"}
    table_of(rows, columns | {"a worker: processor time, s": "{worker:.2f}", "a worker: up, s": "{worker_up:.1f}"})
    return rows
