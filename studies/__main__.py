"""Runs all benchmarks, or those named: `python -m tests.benchmarks rendering bare_loop`."""

import json
import subprocess
import sys

from tests.benchmarks.document import WRITTEN, write

BENCHMARKS = (
    "rendering",
    "bound",
    "frames",
    "control_step",
    "bare_loop",
    "throughput",
    "answers",
    "inference",
    "overhead",
    "environments",
    "behaviour_cost",
    "vector_env",
    "remote",
    "workers",
)
LONG = (
    *(
        "ablations",
        "boundaries",
        "clusters_found",
        "command_start",
        "coverage",
        "crowd",
        "dashboard",
        "failure_kinds",
        "libero_cost",
        "libero_frames",
        "libero_oracles",
        "libero_routers",
        "ray_start",
    ),
    *("mergevla", "million", "opening", "operators", "paper_size", "readers", "resume", "scale"),
    *("oracles", "sensitivity_coverage", "simplified_meshes", "worst_cases"),
)
INSTALLS = ("first_use", "vla_eval")
NEED_DEMONSTRATIONS = (
    *("arms", "merges", "more_experts", "more_experts_routing", "routers", "training_controls", "unknown_tasks"),
    *(
        "doors",
        "shifted_routing",
        "libero_experts",
        "libero_merges",
        "libero_plus",
        "two_arms",
        "equal_budget",
        "robust_experts",
        "merging_under_shift",
        "so101",
        "stacking",
    ),
)
NEED_GPU = ("gpu_answers", "gpu_runs")
ON_DEMAND = (*LONG, *NEED_DEMONSTRATIONS, *INSTALLS, *NEED_GPU)
"""Run only when named."""
CODE = """
import json
from tests.benchmarks import {name} as benchmark, shared
rows = benchmark.measure()
print("bench:" + json.dumps({{"columns": shared.COLUMNS, "rows": rows}}))
"""


def main() -> None:
    """Run each benchmark in its own process, so that they do not share memory or threads."""
    wanted = sys.argv[1:] or list(BENCHMARKS)
    unknown = [name for name in wanted if name not in (*BENCHMARKS, *ON_DEMAND)]
    if unknown:
        sys.exit(f"unknown benchmark {unknown[0]}; known: {', '.join((*BENCHMARKS, *ON_DEMAND))}")
    for name in wanted:
        print(f"\n== {name}", flush=True)
        code = CODE.format(name=name)
        process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        for line in process.stdout:
            if line.startswith("bench:"):
                write(name, json.loads(line.removeprefix("bench:")))
            else:
                print(line, end="", flush=True)
        if process.wait():
            sys.exit(f"benchmark {name} failed")
    print(f"\nwritten to {WRITTEN}/")


main()
