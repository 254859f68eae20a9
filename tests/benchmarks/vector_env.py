"""The same episodes by the same policy through two workers and through a gymnasium vector environment of two processes.

The vector environment is used as evaluation loops commonly do (LeRobot's, for one): every step returns the images, a
batch of episodes is stepped until the last of them has ended, then the next batch begins.
"""

import os
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AsyncVectorEnv, AutoresetMode

from adapters import catalog
from adapters.contract import Observation
from orchestrator.worker_environment import worker_environment
from policies.catalog import load
from policies.contract import Query
from results.run import read_run
from results.store import Store
from suites.vocabulary import Condition, View
from tests.benchmarks.shared import TASKS, episodes, open_task, table

PROCESSES, EPISODES, HORIZON, CHUNK = 2, 24, 40, 8
SUITE = """
name: vector-env
policies: [untrained]
tasks: [{task}]
seeds: {{count: {episodes}}}
horizon: {horizon}
workers: {processes}
"""


class ToGymnasium(gymnasium.Env[dict[str, Any], Any]):
    """A task as an environment with image observations."""

    def __init__(self, task: str) -> None:
        self._simulation, self._steps = open_task(task, View()), 0
        spec, view = self._simulation.action_spec, View()
        frame = spaces.Box(0, 255, (view.image_size, view.image_size, 3), np.uint8)
        state = spaces.Box(-np.inf, np.inf, (8,), np.float64)
        self.observation_space = spaces.Dict({"state": state} | dict.fromkeys(view.cameras, frame))
        self.action_space = spaces.Box(spec.low, spec.high, dtype=np.float64)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict[str, Any], Any]:
        """Start the seed's episode."""
        assert seed is not None
        self._simulation.reset(seed, Condition())
        self._steps = 0
        return self._seen(), {}

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Step and look."""
        outcome = self._simulation.step(action)
        self._steps += 1
        return self._seen(), outcome.reward, outcome.success, self._steps >= HORIZON, {}

    def state_hash(self) -> str:
        """The simulation's."""
        return self._simulation.state_hash()

    def _seen(self) -> dict[str, Any]:
        observation = self._simulation.observe()
        return {"state": observation.proprioception, **observation.images}


def plain(task: str) -> tuple[float, list[str]]:
    """Seconds for all episodes in batches, after start-up, and their last states."""
    make = partial(ToGymnasium, task)
    batch = AsyncVectorEnv([make] * PROCESSES, context="spawn", autoreset_mode=AutoresetMode.DISABLED)
    policy, view, hashes = load("untrained", {}), View(), list[str]()
    instruction = catalog.task_cards()[task].instruction
    low, high = batch.single_action_space.low, batch.single_action_space.high  # type: ignore[attr-defined]
    batch.reset(seed=list(range(PROCESSES)))
    start = time.perf_counter()
    everything = list(episodes(task, "untrained", view, EPISODES, horizon=HORIZON))
    for first in range(0, EPISODES, PROCESSES):
        own = everything[first : first + PROCESSES]
        seen, _ = batch.reset(seed=[episode.seed for episode in own])
        policy.reset(own)
        over, step = np.zeros(PROCESSES, bool), 0
        chunks: Any = None
        while not over.all():
            if step % CHUNK == 0:
                looks = [
                    Observation({camera: seen[camera][i] for camera in view.cameras}, seen["state"][i], instruction)
                    for i in range(PROCESSES)
                ]
                queries = [Query(episode, step, observation=look) for episode, look in zip(own, looks, strict=True)]
                chunks = np.stack([decision.actions for decision in policy.act(queries)])
            seen, _, terminated, truncated, _ = batch.step(np.clip(chunks[:, step % CHUNK], low, high))
            over |= terminated | truncated
            step += 1
        hashes += batch.call("state_hash")
        policy.finish(own)
    seconds = time.perf_counter() - start
    batch.close()
    return seconds, hashes


def ours(task: str) -> tuple[float, list[str]]:
    """Seconds from the first episode's start to the last one's end in a user's run, and their last states."""
    with tempfile.TemporaryDirectory() as folder:
        suite, run = Path(folder) / "suite.yaml", Path(folder) / "run"
        text = SUITE.format(task=task, episodes=EPISODES, horizon=HORIZON, processes=PROCESSES)
        suite.write_text(text, encoding="utf-8")
        command = [sys.executable, "-c", "from orchestrator.cli import main; main()", "run", str(suite)]
        subprocess.run([*command, "--out", str(run), "--no-media"], check=True, capture_output=True)
        store = Store.open_file(run / "episodes.sqlite", read_run(run).run_id)
        rows = sorted(store.results(), key=lambda row: row.seed)
        store.close()
    seconds = max(row.started_at + row.wall_s for row in rows) - min(row.started_at for row in rows)
    return seconds, [row.final_state_hash or "" for row in rows]


def measure() -> list[dict[str, object]]:
    """Episodes per hour of both on two processes each, one after the other, for a policy with chunks of 8."""
    found = []
    for task in TASKS:
        os.environ.update(worker_environment(catalog.find(task.partition("/")[0])))
        (worker_s, last), (plain_s, plain_last) = ours(task), plain(task)
        found.append(
            {
                "task": task,
                "workers_per_hour": 3600 * EPISODES / worker_s,
                "vector_env_per_hour": 3600 * EPISODES / plain_s,
                "ratio": plain_s / worker_s,
                "identical": last == plain_last,
            }
        )
    table(
        ("task", "workers, episodes/h", "gymnasium vector environment, episodes/h", "ratio", "same last states"),
        [
            (
                f["task"],
                f"{f['workers_per_hour']:.0f}",
                f"{f['vector_env_per_hour']:.0f}",
                f"{f['ratio']:.2f}",
                f["identical"],
            )
            for f in found
        ],
    )
    return found
