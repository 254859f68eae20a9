"""The same episodes of the same policies by `robogauntlet run` and by vla-evaluation-harness, one after the other.

Both have the same simulation and the same policy in one worker and in two. The harness has the processes of its manual:
a model server on the loopback address, which answers with chunks from its own buffer, and `vla-eval run` as the client,
or two of them that share a queue. As in all its benchmarks, every step returns the images, which it sends as PNG by
default; "whole scene" is the default without our culling of what is outside the view. Neither side counts the first
episode of a process, in which it warms up, nor what came before.
"""

import json
import os
import subprocess
import tempfile
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from itertools import pairwise
from pathlib import Path
from statistics import mean
from typing import Any

import yaml

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.environments.environment import Environment
from robogauntlet.orchestrator.environments.installer import create
from robogauntlet.orchestrator.environments.resolver import worker_environment
from robogauntlet.suites.environments import EnvironmentEntry
from tests import ROOT
from tests.benchmarks.shared import POLICY_OPTIONS, TASKS, play_suite, table_of

HARNESS = EnvironmentEntry(
    requirements=("anyio>=4", "msgpack>=1", "websockets>=13", "lazyregistry>=0.4", "omegaconf"),
    without_dependencies=("vla-eval==0.8.0",),
)
CLASSES = "tests.benchmarks.vla_eval_classes"
EPISODES = 6
VARIANTS = {"png": ("png", True), "raw": ("raw", True), "whole": ("png", False)}
"""Format of the images, and whether what is outside the view is culled."""
SUITE = """
name: side-by-side
policies: {policies}
tasks: [{task}]
seeds: {{count: {episodes}}}
render_profile: fast
workers: {workers}
"""
Played = Mapping[str, Any]
"""An episode: `process` that played it, when it `ended` (s), its `group`, `seed`, and whether it `succeeded`."""


def seconds_per_episode(played: Sequence[Played], group: tuple[object, ...]) -> float:
    """Mean time between the ends of two successive episodes of a group in one process."""
    processes = defaultdict(list)
    for episode in sorted(played, key=lambda episode: episode["ended"]):
        processes[episode["process"]].append(episode)
    pairs = [pair for episodes in processes.values() for pair in pairwise(episodes)]
    return mean(b["ended"] - a["ended"] for a, b in pairs if a["group"] == b["group"] == group)


def ours(task: str, workers: int) -> list[Played]:
    """Play the episodes of all policies by the command line."""
    policies = json.dumps([{"kind": kind, "options": options} for kind, options in POLICY_OPTIONS.items()])
    rows = play_suite(SUITE.format(policies=policies, task=task, episodes=EPISODES, workers=workers))
    return [
        {
            "group": (row.policy,),
            "process": row.worker,
            "ended": row.started_at + row.wall_s,
            **{"seed": row.seed, "succeeded": row.status == "success", "steps": row.steps},
        }
        for row in rows
    ]


def theirs(python: Path, url: str, task: str, workers: int) -> list[Played]:
    """Play the episodes of all policies in all variants by the harness."""
    with tempfile.TemporaryDirectory() as name, ExitStack() as clients:
        log, config = Path(name) / "log", Path(name) / "config.yaml"
        entries = [
            {
                "benchmark": f"{CLASSES}:GauntletTask",
                "name": f"{policy}-{variant}",
                "episodes_per_task": EPISODES,
                "params": {
                    **{"task": task, "policy": policy, "log": str(log)},
                    **dict(zip(("image_format", "culling"), VARIANTS[variant], strict=True)),
                },
            }
            for policy in POLICY_OPTIONS
            for variant in VARIANTS
        ]
        config.write_text(yaml.safe_dump({"server": {"url": url}, "output_dir": name, "benchmarks": entries}))
        command = [str(python.with_name("vla-eval")), "run", "--no-docker", "--config", str(config), "--eval-id", "it"]
        shards = [["--num-shards", str(workers), "--shard-id", str(i)] for i in range(workers)] if workers > 1 else [[]]
        output = clients.enter_context((Path(name) / "output").open("w+"))
        for process in [clients.enter_context(_process([*command, *shard], output, output)) for shard in shards]:
            assert process.wait() == 0, (Path(name) / "output").read_text()
        lines = [json.loads(line) for line in log.read_text().splitlines()]
    return [line | {"group": (line["policy"], line["image_format"], line["culling"])} for line in lines]


def _process(command: list[str], output: Any, errors: Any = None) -> "subprocess.Popen[str]":
    """A process in the harness's environment that imports this source, with the variables of our workers."""
    variables = {"PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "src")])}
    for simulator in catalog.simulators().values():
        variables |= worker_environment(simulator)
    environment = {**os.environ, **variables}
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=output, stderr=errors, text=True, env=environment)


@contextmanager
def _server(python: Path) -> Iterator[str]:
    """Serve the policies, and give the address."""
    with _process([str(python), "-m", CLASSES], subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        url = process.stdout.readline().strip()
        assert url.startswith("ws://127.0.0.1:"), url
        yield url
        process.stdin.close()


def measure() -> list[dict[str, object]]:
    """Episodes per hour of both, for each task, policy and number of workers."""
    os.environ["ROBOGAUNTLET_CONFIG"] = os.devnull
    os.environ.setdefault("ROBOGAUNTLET_ENVIRONMENTS", str(Path("runs/bench/environments").absolute()))
    environment = Environment("vla-eval", HARNESS, "the benchmark")
    create(environment, print)
    rows: list[dict[str, object]] = []
    with _server(environment.python) as url:
        for task in TASKS:
            for workers in (1, 2):
                own, other = ours(task, workers), theirs(environment.python, url, task, workers)
                rows += [_row(task, policy, workers, own, other) for policy in POLICY_OPTIONS]
    columns = {"task": "{task}", "policy": "{policy}", "workers": "{workers}", "episodes/h": "{ours:,.0f}"}
    columns |= {"vla-eval, PNG": "{png:,.0f}", "ratio": "{png_ratio:.1f}"}
    columns |= {"raw": "{raw:,.0f}", "ratio ": "{raw_ratio:.1f}"}
    columns |= {"PNG, whole scene": "{whole:,.0f}", "ratio  ": "{whole_ratio:.1f}"}
    table_of(rows, columns | {"equal outcomes": "{equal} of {compared}"})
    return rows


def _row(task: str, policy: str, workers: int, own: list[Played], other: list[Played]) -> dict[str, object]:
    rate = 3600 * workers / seconds_per_episode(own, (policy,))
    row: dict[str, object] = {"task": task, "policy": policy, "workers": workers, "ours": rate}
    for variant, labels in VARIANTS.items():
        row[variant] = harness = 3600 * workers / seconds_per_episode(other, (policy, *labels))
        row[f"{variant}_ratio"] = rate / harness
    outcomes = {episode["seed"]: _outcome(episode) for episode in own if episode["group"][0] == policy}
    compared = [episode for episode in other if episode["group"][0] == policy]
    assert len(compared) == len(VARIANTS) * len(outcomes) == len(VARIANTS) * EPISODES
    row["equal"] = sum(_outcome(episode) == outcomes[episode["seed"]] for episode in compared)
    return row | {"compared": len(compared)}


def _outcome(episode: Played) -> tuple[bool, int]:
    return episode["succeeded"], episode["steps"]
