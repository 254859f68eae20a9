"""A whole run of a user, from the command to the table, by our command and by that of vla-evaluation-harness.

The shipped experts play 30 seeds of one task in each of three simulators. The harness plays in two shards, as its own
script for several processes starts them, and asks a server in a third process; its frames and steps are the
simulator's own. Ours writes a report as well.
"""

import json
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from statistics import median

import yaml

from robogauntlet.results.api import open_run
from studies.percent import few
from studies.performance.vla_eval import harness_python, harness_variables
from studies.shared import EXPERTS, GAUNTLET, POLICY_OPTIONS, TASKS, table_of
from studies.tables import ROOT

SEEDS = few(30)
TIMES = 2
SHARDS = 2
PROCESS = "studies.performance.vla_eval_process"
Outcomes = dict[tuple[str, int], tuple[bool, int]]
"""Task and seed to whether the episode succeeded, and its steps."""


def measure() -> list[dict[str, object]]:
    """Medians of the time to the table (s) by turns, and in how many episodes the outcomes are equal."""
    python = harness_python()
    taken: dict[str, list[float]] = {"ours": [], "theirs": []}
    equal = []
    for number in range(few(TIMES, 1) + 1):
        with tempfile.TemporaryDirectory() as folder:
            ours, own = _ours(Path(folder) / "run")
            theirs, other = _theirs(python, Path(folder))
        assert own.keys() == other.keys()
        if number:  # the first fills the disk's cache, and robosuite's of compiled code
            taken["ours"].append(ours)
            taken["theirs"].append(theirs)
            equal.append(sum(own[key] == other[key] for key in own))
    times = {name: median(values) for name, values in taken.items()}
    row: dict[str, object] = {"episodes": len(own), **times, "equal": min(equal)}
    row["ratio"] = times["theirs"] / times["ours"]
    columns = {"episodes": "{episodes}", "robogauntlet, s": "{ours:.0f}", "vla-eval, s": "{theirs:.0f}"}
    table_of([row], columns | {"ratio": "{ratio:.1f}", "equal outcomes": "{equal} of {episodes}"})
    return [row]


def _ours(folder: Path) -> tuple[float, Outcomes]:
    (option,) = POLICY_OPTIONS[EXPERTS].values()
    command = [*GAUNTLET, "run", "--policy", option, "--seeds", str(SEEDS), "--render-profile", "fast"]
    command += ["--out", str(folder), *(f"--task={task}" for task in TASKS)]
    start = time.perf_counter()
    subprocess.run(command, check=True, stdout=sys.stderr)
    taken = time.perf_counter() - start
    frame = open_run(folder).episodes(("task", "seed", "status", "steps"))
    return taken, {(row.task, row.seed): (row.status == "success", row.steps) for row in frame.itertuples()}


def _theirs(python: Path, folder: Path) -> tuple[float, Outcomes]:
    entries = [
        {
            "benchmark": f"{PROCESS}:NamedTask",
            "name": task.replace("/", "-"),
            "episodes_per_task": SEEDS,
            "params": {"task": task},
        }
        for task in TASKS
    ]
    config, results = folder / "config.yaml", folder / "results"
    config.write_text(yaml.safe_dump({"benchmarks": entries, "output_dir": str(results)}), encoding="utf-8")
    environment, command = harness_variables(), [str(python), "-m", "vla_eval.cli.main"]
    start = time.perf_counter()
    with ExitStack() as stack:
        server = stack.enter_context(
            subprocess.Popen(
                [str(python), "-m", PROCESS],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                env=environment,
                cwd=ROOT,
            )
        )
        assert server.stdout is not None
        assert server.stdin is not None
        url = next(line for line in server.stdout if line.startswith("ws:")).strip()
        run = [*command, "run", "--no-docker", "-c", str(config), "--server-url", url, "--eval-id", "whole"]
        shards = [
            stack.enter_context(
                subprocess.Popen(
                    [*run, "--shard-id", str(shard), "--num-shards", str(SHARDS)],
                    stdout=sys.stderr,
                    env=environment,
                    cwd=ROOT,
                )
            )
            for shard in range(SHARDS)
        ]
        codes = [shard.wait() for shard in shards]
        assert not any(codes), codes
        (database,) = results.glob("*.sqlite")
        subprocess.run([*command, "export", str(database)], check=True, stdout=sys.stderr, env=environment, cwd=ROOT)
        taken = time.perf_counter() - start
        server.stdin.close()
    played = [
        episode
        for path in results.glob("*_aggregate.json")
        for task in json.loads(path.read_text(encoding="utf-8"))["tasks"]
        for episode in task["episodes"]
    ]
    outcomes = {(one["name"], one["episode_idx"]): (one["metrics"]["success"], one["steps"]) for one in played}
    return taken, outcomes
