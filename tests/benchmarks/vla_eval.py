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
EPISODES = 5
VARIANTS = {"PNG": ("png", True), "raw": ("raw", True), "PNG, whole scene": ("png", False)}
"""Format of the frames, and whether what is outside the view is culled; two workers skip the last, to save time."""
OURS = "ours"
SUITE = """
name: side-by-side
policies: {policies}
tasks: [{task}]
seeds: {{count: {episodes}}}
render_profile: fast
workers: {workers}
"""
Played = Mapping[str, Any]
"""An episode: policy, variant or `OURS`, process, seed, whether it succeeded, steps, and when it ended (s)."""


def ours(task: str, workers: int) -> list[Played]:
    """Play the episodes of all policies by the command line."""
    policies = json.dumps([{"kind": kind, "options": options} for kind, options in POLICY_OPTIONS.items()])
    rows = play_suite(SUITE.format(policies=policies, task=task, episodes=EPISODES, workers=workers))
    return [
        {"policy": row.policy, "variant": OURS, "process": row.worker, "seed": row.seed}
        | {"succeeded": row.status == "success", "steps": row.steps, "ended": row.started_at + row.wall_s}
        for row in rows
    ]


def theirs(python: Path, url: str, task: str, workers: int) -> list[Played]:
    """Play the episodes of all policies in all variants by the harness."""
    with tempfile.TemporaryDirectory() as name, ExitStack() as clients:
        log, config = Path(name) / "log", Path(name) / "config.yaml"
        wanted = list(VARIANTS)[: 3 if workers == 1 else 2]
        entries = [
            {
                "benchmark": f"{CLASSES}:GauntletTask",
                "name": f"{policy} {variant}",
                "episodes_per_task": EPISODES,
                "params": {"task": task, "policy": policy, "variant": variant, "log": str(log)},
            }
            for policy in POLICY_OPTIONS
            for variant in wanted
        ]
        config.write_text(yaml.safe_dump({"server": {"url": url}, "output_dir": name, "benchmarks": entries}))
        command = [str(python.with_name("vla-eval")), "run", "--no-docker", "--config", str(config), "--eval-id", "it"]
        shards = [["--num-shards", str(workers), "--shard-id", str(i)] for i in range(workers)] if workers > 1 else [[]]
        output = clients.enter_context((Path(name) / "output").open("w+"))
        for process in [clients.enter_context(_process([*command, *shard], output, output)) for shard in shards]:
            assert process.wait() == 0, (Path(name) / "output").read_text()
        played = [json.loads(line) for line in log.read_text().splitlines()]
    assert len(played) == len(entries) * EPISODES
    return played


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
                played = [*ours(task, workers), *theirs(environment.python, url, task, workers)]
                rows += [{"task": task, "workers": workers} | row for row in compare(played, workers)]
    columns = {"task": "{task}", "policy": "{policy}", "workers": "{workers}", "frames": "{frames}"}
    columns |= {"robogauntlet, episodes/h": "{ours:,.0f}", "vla-eval": "{theirs:,.0f}", "ratio": "{ratio:.1f}"}
    table_of(rows, columns | {"equal outcomes": f"{{equal}} of {EPISODES}"})
    return rows


def compare(played: Sequence[Played], workers: int) -> Iterator[dict[str, object]]:
    """A row for each policy and variant of the harness, from the episodes of one task."""
    for policy in POLICY_OPTIONS:
        groups = defaultdict(list)
        for episode in sorted(played, key=lambda episode: episode["ended"]):
            if episode["policy"] == policy:
                groups[episode["variant"]].append(episode)
        own = groups.pop(OURS)
        for variant, others in groups.items():
            rates = [3600 * workers / seconds_per_episode(group) for group in (own, others)]
            row = {"policy": policy, "frames": variant, "ours": rates[0], "theirs": rates[1]}
            yield row | {"ratio": rates[0] / rates[1], "equal": len(outcomes(own) & outcomes(others))}


def seconds_per_episode(group: Sequence[Played]) -> float:
    """Time of a control step in all episodes but the first of each process, times the mean number of steps."""
    processes = defaultdict(list)
    for episode in group:
        processes[episode["process"]].append(episode)
    seconds = sum(episodes[-1]["ended"] - episodes[0]["ended"] for episodes in processes.values())
    steps = sum(episode["steps"] for episodes in processes.values() for episode in episodes[1:])
    return seconds / steps * mean(episode["steps"] for episode in group)


def outcomes(group: Sequence[Played]) -> set[tuple[int, bool, int]]:
    """Seeds, with what became of them."""
    return {(episode["seed"], episode["succeeded"], episode["steps"]) for episode in group}
