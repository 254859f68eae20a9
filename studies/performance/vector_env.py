"""The same episodes of the same policy with two workers and with a gymnasium vector environment of two processes.

The vector environment is used as evaluation loops commonly do (LeRobot's, for one): every step returns the images, the
policy answers for the whole batch, and a batch is stepped until the last of its episodes has ended.
"""

import json
import os
import time
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from gymnasium.vector import AsyncVectorEnv, AutoresetMode

import robogauntlet
from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import Observation
from robogauntlet.orchestrator.api.task_environment import TaskEnvironment
from robogauntlet.orchestrator.environments.resolver import worker_environment
from robogauntlet.policies.catalog import load
from robogauntlet.policies.contract import Query
from robogauntlet.suites.episode import Episode
from studies.percent import few
from studies.shared import (
    EXPERT_VIEW as VIEW,
    POLICY_OPTIONS,
    TASKS,
    duration_s,
    episodes,
    play_suite,
    speed_up,
    table_of,
)

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


def opened(task: str, *, own: bool) -> TaskEnvironment:
    """A task as an environment with image observations."""
    for simulator in catalog.simulators().values():
        os.environ.update(worker_environment(simulator))
    environment = robogauntlet.make(task, image_size=VIEW.image_size, render_profile=VIEW.render_profile)
    speed_up(environment.simulation, wanted=own)
    return environment


def plain(task: str, kind: str, *, own: bool) -> tuple[float, list[bool], int]:
    """Duration of all episodes in batches without start-up (s), their successes, and the length of a chunk."""
    make = partial(opened, task, own=own)
    batch = AsyncVectorEnv([make] * PROCESSES, context="spawn", autoreset_mode=AutoresetMode.DISABLED)
    policy, succeeded = load(kind, POLICY_OPTIONS[kind]), list[bool]()
    instruction = catalog.task_descriptions()[task].instruction
    everything = list(episodes(task, kind, VIEW, few(EPISODES)))

    def query(seen: Any, playing: Sequence[Episode], step: int) -> Any:
        shown = ({camera: seen["images"][camera][i] for camera in VIEW.cameras} for i in range(PROCESSES))
        observations = [Observation(images, seen["proprioception"][i], instruction) for i, images in enumerate(shown)]
        queries = [
            Query(episode, step, observation=observation)
            for episode, observation in zip(playing, observations, strict=True)
        ]
        return np.stack([decision.actions for decision in policy.act(queries)])

    seen, _ = batch.reset(seed=list(range(PROCESSES)))
    # This loads the expert before the clock starts; our workers load it within the measured time.
    chunk = query(seen, everything[:PROCESSES], 0).shape[1]
    start = time.perf_counter()
    for first in range(0, few(EPISODES), PROCESSES):
        playing = everything[first : first + PROCESSES]
        seen, _ = batch.reset(seed=[episode.seed for episode in playing])
        policy.reset(playing)
        won, over, step = np.zeros(PROCESSES, bool), np.zeros(PROCESSES, bool), 0
        chunks: Any = None
        while not over.all():
            if step % chunk == 0:
                chunks = query(seen, playing, step)
            seen, _, terminated, truncated, _ = batch.step(chunks[:, step % chunk])
            won |= terminated & ~over
            over |= terminated | truncated
            step += 1
        succeeded += won.tolist()
        policy.finish(playing)
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
    for task, kind in PAIRS[: few(len(PAIRS))]:
        os.environ.update(worker_environment(catalog.find(task.partition("/")[0])))
        worker_s, won = ours(task, kind)
        for steps, own in SIMULATIONS.items():
            plain_s, plain_won, chunk = plain(task, kind, own=own)
            rates = {"workers_per_hour": 3600 * len(won) / worker_s, "vector_env_per_hour": 3600 * len(won) / plain_s}
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
