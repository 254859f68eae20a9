"""Runs all benchmarks, or those named: `python -m tests.benchmarks rendering bare_loop`."""

import json
import os
import platform
import re
import subprocess
import sys
from datetime import date
from importlib import metadata
from pathlib import Path

from tests.benchmarks.shared import FOLDER

BENCHMARKS = (
    "rendering",
    "bound",
    "frames",
    "control_step",
    "bare_loop",
    "throughput",
    "oracles",
    "answers",
    "inference",
    "overhead",
    "environments",
    "vector_env",
    "remote",
    "workers",
)
LONG = (
    *("coverage", "crowd", "dashboard", "mergevla", "million", "opening", "operators", "readers"),
    *("resume", "scale", "shifted_routing", "simplified_meshes"),
)
INSTALLS = ("first_use", "vla_eval")
NEED_DEMONSTRATIONS = ("merges", "training_controls")
ON_DEMAND = (*LONG, *NEED_DEMONSTRATIONS, *INSTALLS)
"""Run only when named."""
CODE = """
import json
from tests.benchmarks import {name} as benchmark, shared
rows = benchmark.measure()
print("bench:" + json.dumps({{"columns": shared.COLUMNS, "rows": rows}}))
"""
PACKAGES = ("mujoco", "robosuite", "sapien", "mani-skill", "pybullet", "torch", "ray")


def machine() -> str:
    """Cores and model of the processor."""
    model = re.search(r"model name\s*: (.*)", Path("/proc/cpuinfo").read_text(encoding="utf-8"))
    return f"{len(os.sched_getaffinity(0))} cores of {model[1] if model else platform.processor()}"


def versions() -> dict[str, str]:
    """Versions of the simulators and of what plays them."""
    return {name: metadata.version(name) for name in PACKAGES}


def main() -> None:
    """Run each benchmark in its own process, so that they do not share memory or threads."""
    wanted = sys.argv[1:] or list(BENCHMARKS)
    unknown = [name for name in wanted if name not in (*BENCHMARKS, *ON_DEMAND)]
    if unknown:
        sys.exit(f"unknown benchmark {unknown[0]}; known: {', '.join((*BENCHMARKS, *ON_DEMAND))}")
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name in wanted:
        print(f"\n== {name}", flush=True)
        code = CODE.format(name=name)
        process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        for line in process.stdout:
            if line.startswith("bench:"):
                result = {"date": str(date.today()), "machine": machine(), "versions": versions()}
                result |= json.loads(line.removeprefix("bench:"))
                (FOLDER / f"{name}.json").write_text(json.dumps(result, indent=1) + "\n")
            else:
                print(line, end="", flush=True)
        if process.wait():
            sys.exit(f"benchmark {name} failed")
    print(f"\nwritten to {FOLDER}/")


main()
