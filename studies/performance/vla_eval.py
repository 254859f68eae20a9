"""The same episodes of the same policies by our `rollout` and by vla-evaluation-harness's runner, in turn.

Both have the same simulation and the same policy. The harness has its model server in a thread of the process, on the
loopback address, as in its `evaluate`; the server answers with chunks from its own buffer. As in all its benchmarks,
every step returns the images, which it sends as PNG by default. It plays our simulation, and the simulator's own frames
and steps. Two workers are two such processes. Ratios are medians of pairs; other load of the machine
changes those of the CPU time little.
"""

import json
import os
import subprocess
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from statistics import mean, median
from typing import Any

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.environments.environment import Environment
from robogauntlet.orchestrator.environments.installer import create
from robogauntlet.orchestrator.environments.resolver import worker_environment
from robogauntlet.suites.environments import EnvironmentEntry
from studies.percent import few
from studies.shared import POLICY_OPTIONS, TASKS, table_of
from studies.tables import ROOT

HARNESS = EnvironmentEntry(
    requirements=("anyio>=4", "msgpack>=1", "websockets>=13", "lazyregistry>=0.4", "omegaconf"),
    without_dependencies=("vla-eval==0.8.0",),
)
PROCESS = "studies.performance.vla_eval_process"
EPISODES = few(4)
OURS = "ours"
VARIANTS = {
    "raw, our simulation": ("raw", True),
    "PNG, our simulation": ("png", True),
    "PNG, the simulator's own": ("png", False),
}
"""Format of the frames that the harness sends, and whether frames and steps are those of our simulation."""
Played = Mapping[str, Any]
"""An episode: policy, variant or `OURS`, seed, whether it succeeded, steps, and wall and CPU time (s)."""


def harness_python() -> Path:
    """The interpreter of the harness's environment, which is created if necessary."""
    os.environ["ROBOGAUNTLET_CONFIG"] = os.devnull
    os.environ.setdefault("ROBOGAUNTLET_ENVIRONMENTS", str(Path("runs/bench/environments").absolute()))
    environment = Environment("vla-eval", HARNESS, "the benchmark")
    create(environment, print)
    return environment.python


def harness_variables() -> dict[str, str]:
    """The environment variables of its processes, which import this source and open any simulator."""
    variables = {"PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "src")])}
    for simulator in catalog.simulators().values():
        variables |= worker_environment(simulator)
    return {**os.environ, **variables}


def measure() -> list[dict[str, object]]:
    """Episodes per hour of both, for each task, policy and number of workers."""
    python = harness_python()
    rows: list[dict[str, object]] = []
    for task in TASKS[: few(len(TASKS), 1)]:
        for workers in (1, 2):
            for row in compare(play(python, task, workers), workers):
                rows.append({"task": task, "workers": workers, **row})
                print(json.dumps(rows[-1]), flush=True)
    columns = {"task": "{task}", "policy": "{policy}", "workers": "{workers}", "vla-eval plays": "{frames}"}
    columns |= {"robogauntlet, episodes/h": "{ours:,.0f}", "vla-eval": "{theirs:,.0f}", "ratio": "{ratio:.1f}"}
    table_of(rows, columns | {"CPU time, ratio": "{cpu_ratio:.1f}", "equal outcomes": f"{{equal}} of {EPISODES}"})
    return rows


def play(python: Path, task: str, workers: int) -> list[Played]:
    """Play the seeds of a task in processes of the harness's environment."""
    environment = harness_variables()
    seeds = [[str(seed) for seed in range(first, EPISODES, workers)] for first in range(workers)]
    with ExitStack() as stack:
        processes = [
            stack.enter_context(
                subprocess.Popen(
                    [str(python), "-m", PROCESS, task, *own], stdout=subprocess.PIPE, text=True, env=environment
                )
            )
            for own in seeds
        ]
        printed = [process.communicate()[0] for process in processes]
        assert not any(process.returncode for process in processes), printed
    return [json.loads(line) for lines in printed for line in lines.splitlines() if line.startswith("{")]


def compare(played: Sequence[Played], workers: int) -> Iterator[dict[str, object]]:
    """A row for each policy and variant of the harness, from the episodes of one task."""
    groups: dict[tuple[str, str], dict[int, Played]] = defaultdict(dict)
    for episode in played:
        groups[episode["policy"], episode["variant"]][episode["seed"]] = episode
    for policy in POLICY_OPTIONS:
        own = groups[policy, OURS]
        for variant in VARIANTS:
            pairs = [(own[seed], other) for seed, other in groups[policy, variant].items()]
            assert len(pairs) == EPISODES
            fast, slow = (3600 * workers / mean(pair[side]["wall_s"] for pair in pairs) for side in (0, 1))
            yield {
                "policy": policy,
                "frames": variant,
                "ours": fast,
                "theirs": slow,
                "ratio": median(b["wall_s"] / a["wall_s"] for a, b in pairs),
                "cpu_ratio": median(b["cpu_s"] / a["cpu_s"] for a, b in pairs),
                "equal": sum(all(a[name] == b[name] for name in ("succeeded", "steps")) for a, b in pairs),
            }
