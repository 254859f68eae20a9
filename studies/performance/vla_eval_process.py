"""Plays seeds by our `rollout` and by vla-evaluation-harness, in the environment of the benchmark `vla_eval`.

Arguments: a task and seeds. Prints a line of JSON for each episode.
"""

import json
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import anyio
import numpy as np
from vla_eval.api import serve_background
from vla_eval.benchmarks.base import StepBenchmark, StepResult
from vla_eval.connection import Connection
from vla_eval.model_servers.predict import PredictModelServer
from vla_eval.protocol.numpy_codec import set_image_format
from vla_eval.runners.sync_runner import SyncEpisodeRunner

from robogauntlet.adapters.contract import Observation
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.policies.catalog import load
from robogauntlet.policies.contract import Policy, Query
from robogauntlet.suites.episode import Cell, Episode, Protocol
from studies.performance.vla_eval import OURS, VARIANTS
from studies.shared import EXPERT_VIEW, POLICY_OPTIONS, SteppedTask, speed_up


class GauntletTask(StepBenchmark):
    """A task that observes after every step; the harness sends every observation."""

    def __init__(self, stepped: SteppedTask) -> None:
        super().__init__()
        self._stepped = stepped

    def get_tasks(self) -> list[dict[str, Any]]:
        """None: the episodes are chosen below."""
        return []

    def reset(self, task: dict[str, Any]) -> Observation:
        """Start the episode."""
        return self._stepped.reset(task["seed"])

    def step(self, action: dict[str, Any]) -> StepResult:
        """Step and observe."""
        observation, reward = self._stepped.step(action["actions"].view(np.float64))
        return StepResult(observation, reward, self._stepped.succeeded or self._stepped.timed_out, {})

    def make_obs(self, raw_obs: Observation, task: dict[str, Any]) -> dict[str, Any]:
        """The keys that the harness recommends."""
        images, state = dict(raw_obs.images), raw_obs.proprioception
        return {"images": images, "state": state, "task_description": raw_obs.instruction}

    def get_step_result(self, step_result: StepResult) -> dict[str, Any]:
        """The outcome."""
        return {"success": self._stepped.succeeded}


class GauntletPolicy(PredictModelServer):
    """A policy. The server's own buffer holds the rest of a chunk."""

    def __init__(self, policy: Policy, cell: Cell) -> None:
        super().__init__(chunk_size=cell.protocol.replan_every)
        self._policy, self._cell = policy, cell
        self._episodes: dict[str, Episode] = {}

    async def on_episode_start(self, config: dict[str, Any], ctx: Any) -> None:
        """Start the policy's episode."""
        await super().on_episode_start(config, ctx)
        self._episodes[ctx.session_id] = episode = self._cell.episode(config["task"]["seed"])
        self._policy.reset([episode])

    def predict(self, obs: dict[str, Any], ctx: Any) -> dict[str, Any]:
        """The policy's chunk. The harness converts numbers to 32 bits, so 64 are sent as two: the same actions."""
        observation = Observation(obs["images"], obs["state"], obs["task_description"])
        (decision,) = self._policy.act([Query(self._episodes[ctx.session_id], ctx.step, observation)])
        return {"actions": np.ascontiguousarray(decision.actions, np.float64).view(np.float32)}

    async def on_episode_end(self, result: dict[str, Any], ctx: Any) -> None:
        """End the policy's episode."""
        await super().on_episode_end(result, ctx)
        self._policy.finish([self._episodes.pop(ctx.session_id)])


@contextmanager
def timed(**line: Any) -> Iterator[dict[str, Any]]:
    """Print the line with the times of the block, and what the block adds."""
    start, cpu = time.perf_counter(), time.process_time()
    yield line
    line |= {"wall_s": time.perf_counter() - start, "cpu_s": time.process_time() - cpu}
    print(json.dumps(line), flush=True)


async def play_harness(stepped: SteppedTask, url: str, line: dict[str, Any]) -> None:
    """Play an episode by the harness's runner, as its orchestrator does."""
    async with Connection(url) as connection:
        with timed(**line) as played:
            task, steps = {"seed": line["seed"]}, stepped.horizon
            await SyncEpisodeRunner().run_episode(GauntletTask(stepped), task, connection, max_steps=steps)
            played |= {"succeeded": stepped.succeeded, "steps": stepped.steps}


def main(task: str, *seeds: str) -> None:
    """Play the seeds with every policy by both. The first is played twice, to warm up; its second line counts."""
    stepped = SteppedTask(task, EXPERT_VIEW)
    for kind, options in POLICY_OPTIONS.items():
        policy, cell = load(kind, options), Cell(kind, kind, task, Protocol(stepped.horizon, view=EXPERT_VIEW))
        with serve_background(GauntletPolicy(policy, cell)) as server:
            for seed in map(int, (seeds[0], *seeds)):
                speed_up(stepped.simulation, wanted=True)
                with timed(policy=kind, variant=OURS, seed=seed) as played:
                    row = rollout(stepped.simulation, policy, cell.episode(seed))
                    played |= {"succeeded": row.status == "success", "steps": row.steps}
                for variant, (image_format, own) in VARIANTS.items():
                    set_image_format(image_format)
                    speed_up(stepped.simulation, wanted=own)
                    anyio.run(play_harness, stepped, server.url, {"policy": kind, "variant": variant, "seed": seed})


if __name__ == "__main__":
    main(*sys.argv[1:])
    os._exit(0)  # skips the end of the interpreter, in which renderers crash
