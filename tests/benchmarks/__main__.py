"""Runs all benchmarks, or those named: `python -m tests.benchmarks rendering bare_loop`."""

import json
import platform
import subprocess
import sys
from pathlib import Path

BENCHMARKS = (
    "rendering",
    "control_step",
    "bare_loop",
    "throughput",
    "oracles",
    "inference",
    "overhead",
    "environments",
    "vector_env",
    "remote",
    "workers",
)
LONG = ("coverage", "dashboard", "million", "readers", "resume", "scale", "shifted_routing")
NEED_DEMONSTRATIONS = ("merges", "training_controls")
ON_DEMAND = (*LONG, *NEED_DEMONSTRATIONS)
"""Run only when named."""
FOLDER = Path("runs/bench")


def main() -> None:
    """Run each benchmark in its own process, so that they do not share memory or threads."""
    wanted = sys.argv[1:] or list(BENCHMARKS)
    unknown = [name for name in wanted if name not in (*BENCHMARKS, *ON_DEMAND)]
    if unknown:
        sys.exit(f"unknown benchmark {unknown[0]}; known: {', '.join((*BENCHMARKS, *ON_DEMAND))}")
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name in wanted:
        print(f"\n== {name}", flush=True)
        code = f"from tests.benchmarks.{name} import measure; import json; print('bench:' + json.dumps(measure()))"
        process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        for line in process.stdout:
            if line.startswith("bench:"):
                result = {"machine": platform.platform(), "rows": json.loads(line.removeprefix("bench:"))}
                (FOLDER / f"{name}.json").write_text(json.dumps(result, indent=1) + "\n")
            else:
                print(line, end="", flush=True)
        if process.wait():
            sys.exit(f"benchmark {name} failed")
    print(f"\nwritten to {FOLDER}/")


main()
