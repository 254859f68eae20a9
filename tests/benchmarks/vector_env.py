"""The same episodes of the same policy with two workers and with a gymnasium vector environment of two processes.

The vector environment is used as evaluation loops commonly do (LeRobot's, for one): every step returns the images, the
policy answers for the whole batch, and a batch is stepped until the last of its episodes has ended.
"""

import json
import os
import time
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AsyncVectorEnv, AutoresetMode

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import Observation
from robogauntlet.orchestrator.environments.resolver import worker_environment
from robogauntlet.policies.catalog import load
from robogauntlet.policies.contract import Query
from tests.benchmarks.shared import EXPERT_VIEW as VIEW
from tests.benchmarks.shared import POLICY_OPTIONS, TASKS, SteppedTask, duration_s, episodes, play_suite, table_of

PAIRS = tuple((task, policy) for task in TASKS for policy in POLICY_OPTIONS)
PROCESSES, EPISODES = 2, 32
SIMULATIONS = {"ours": True, "the simulator's own": False}
"""The vector environment draws and steps as our workers do, or as the simulators do by themselves."""
SUITE = """
name: vector-env
policies: [{{kind: {policy}, options: {options}}}]
tasks: [{task}]
seeds: {{count: {episodes}}}
render_profile: fast
workers: {processes}
"""


class ToGymnasium(gymnasium.Env[dict[str, Any], Any]):
    """A task as an environment with image observations."""

    def __init__(self, task: str, *, speed_up: bool) -> None:
        self._task = SteppedTask(task, VIEW)
        self._task.speed_up(speed_up)
        spec = self._task.simulation.action_spec
        frame = spaces.Box(0, 255, (VIEW.image_size, VIEW.image_size, 3), np.uint8)
        state = spaces.Box(-np.inf, np.inf, (8,), np.float64)
        self.observation_space = spaces.Dict({"state": state} | dict.fromkeys(VIEW.cameras, frame))
        self.action_space = spaces.Box(spec.low, spec.high, dtype=np.float64)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict[str, Any], Any]:
        """Start the seed's episode."""
        assert seed is not None
        return _as_dict(self._task.reset(seed)), {}

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Step and observe."""
        observation, reward = self._task.step(action)
        return _as_dict(observation), reward, self._task.succeeded, self._task.timed_out, {}

    def close(self) -> None:
        """End the simulation."""
        self._task.simulation.close()


def _as_dict(observation: Observation) -> dict[str, Any]:
    return {"state": observation.proprioception, **observation.images}


def plain(task: str, kind: str, *, speed_up: bool) -> tuple[float, list[bool], int]:
    """Duration of all episodes in batches without start-up (s), their successes, and the length of a chunk."""
    make = partial(ToGymnasium, task, speed_up=speed_up)
    batch = AsyncVectorEnv([make] * PROCESSES, context="spawn", autoreset_mode=AutoresetMode.DISABLED)
    policy, succeeded = load(kind, POLICY_OPTIONS[kind]), list[bool]()
    instruction = catalog.task_descriptions()[task].instruction
    everything = list(episodes(task, kind, VIEW, EPISODES))

    def query(seen: Any, own: Any, step: int) -> Any:
        shown = ({camera: seen[camera][i] for camera in VIEW.cameras} for i in range(PROCESSES))
        observations = [Observation(images, seen["state"][i], instruction) for i, images in enumerate(shown)]
        queries = [
            Query(episode, step, observation=observation)
            for episode, observation in zip(own, observations, strict=True)
        ]
        return np.stack([decision.actions for decision in policy.act(queries)])

    seen, _ = batch.reset(seed=list(range(PROCESSES)))
    # This loads the expert before the clock starts; our workers load it within the measured time.
    chunk = query(seen, everything[:PROCESSES], 0).shape[1]
    start = time.perf_counter()
    for first in range(0, EPISODES, PROCESSES):
        own = everything[first : first + PROCESSES]
        seen, _ = batch.reset(seed=[episode.seed for episode in own])
        policy.reset(own)
        won, over, step = np.zeros(PROCESSES, bool), np.zeros(PROCESSES, bool), 0
        chunks: Any = None
        while not over.all():
            if step % chunk == 0:
                chunks = query(seen, own, step)
            seen, _, terminated, truncated, _ = batch.step(chunks[:, step % chunk])
            won |= terminated & ~over
            over |= terminated | truncated
            step += 1
        succeeded += won.tolist()
        policy.finish(own)
    seconds = time.perf_counter() - start
    batch.close()
    return seconds, succeeded, chunk


def ours(task: str, kind: str) -> tuple[float, list[bool]]:
    """Time from the first episode's start to the last one's end in a run (s), and the successes."""
    options = json.dumps(POLICY_OPTIONS[kind])
    text = SUITE.format(task=task, policy=kind, options=options, episodes=EPISODES, processes=PROCESSES)
    rows = sorted(play_suite(text), key=lambda row: row.seed)
    return duration_s(rows), [row.status == "success" for row in rows]


def measure() -> list[dict[str, object]]:
    """Episodes per hour of both with two processes each, one after the other."""
    rows = []
    for task, kind in PAIRS:
        os.environ.update(worker_environment(catalog.find(task.partition("/")[0])))
        worker_s, won = ours(task, kind)
        for steps, speed_up in SIMULATIONS.items():
            plain_s, plain_won, chunk = plain(task, kind, speed_up=speed_up)
            rates = {"workers_per_hour": 3600 * EPISODES / worker_s, "vector_env_per_hour": 3600 * EPISODES / plain_s}
            same = sum(a == b for a, b in zip(won, plain_won, strict=True))
            row = {"task": task, "policy": kind, "chunk": chunk, "simulation": steps, **rates}
            rows.append({**row, "ratio": plain_s / worker_s, "same_outcomes": same})
    columns = {
        "task": "{task}",
        "policy": "{policy}",
        "chunk": "{chunk}",
        "frames and steps of the vector environment": "{simulation}",
        "workers, episodes/h": "{workers_per_hour:.0f}",
    }
    columns |= {"gymnasium vector environment, episodes/h": "{vector_env_per_hour:.0f}", "ratio": "{ratio:.2f}"}
    table_of(rows, columns | {"same outcomes": f"{{same_outcomes}} of {EPISODES}"})
    return rows
