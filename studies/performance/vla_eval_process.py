"""Plays seeds by our `rollout` and by vla-evaluation-harness, in the environment of the benchmark `vla_eval`.

Arguments: a task and seeds. Prints a line of JSON for each episode. Without arguments, it serves the experts of all
tasks to the harness's own command, prints the address, and ends with its input.
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

from robogauntlet.adapters.catalog import task_descriptions
from robogauntlet.adapters.contract import Observation
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.policies.catalog import load
from robogauntlet.policies.contract import Policy, Query
from robogauntlet.suites.episode import Cell, Episode, Protocol
from studies.performance.vla_eval import OURS, VARIANTS
from studies.shared import EXPERT_VIEW, EXPERTS, POLICY_OPTIONS, TASKS, SteppedTask, speed_up


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
        return self._stepped.reset(task["episode_idx"])

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


class NamedTask(GauntletTask):
    """A task as the harness's command opens it, with the simulator's own frames and steps; seeds are its episodes."""

    def __init__(self, task: str) -> None:
        stepped = SteppedTask(task, EXPERT_VIEW)
        speed_up(stepped.simulation, wanted=False)
        super().__init__(stepped)
        self._task = task

    def get_tasks(self) -> list[dict[str, Any]]:
        """The one task."""
        return [{"name": self._task}]

    def get_metadata(self) -> dict[str, Any]:
        """The horizon."""
        return {"max_steps": self._stepped.horizon}


class GauntletPolicy(PredictModelServer):
    """A policy. The server's own buffer holds the rest of a chunk."""

    def __init__(self, policy: Policy, *cells: Cell) -> None:
        super().__init__(chunk_size=cells[0].protocol.replan_every)
        self._policy, self._cells = policy, {cell.task: cell for cell in cells}
        self._episodes: dict[str, Episode] = {}

    async def on_episode_start(self, config: dict[str, Any], ctx: Any) -> None:
        """Start the policy's episode."""
        await super().on_episode_start(config, ctx)
        task = config["task"]
        self._episodes[ctx.session_id] = episode = self._cells[task["name"]].episode(task["episode_idx"])
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
            task, steps = {"name": line["task"], "episode_idx": line["seed"]}, stepped.horizon
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
                with timed(task=task, policy=kind, variant=OURS, seed=seed) as played:
                    row = rollout(stepped.simulation, policy, cell.episode(seed))
                    played |= {"succeeded": row.status == "success", "steps": row.steps}
                for variant, (image_format, own) in VARIANTS.items():
                    set_image_format(image_format)
                    speed_up(stepped.simulation, wanted=own)
                    line = {"task": task, "policy": kind, "variant": variant, "seed": seed}
                    anyio.run(play_harness, stepped, server.url, line)


def serve() -> None:
    """Serve the experts of all tasks."""
    cells = (
        Cell(EXPERTS, EXPERTS, task, Protocol(task_descriptions()[task].horizon, view=EXPERT_VIEW)) for task in TASKS
    )
    with serve_background(GauntletPolicy(load(EXPERTS, POLICY_OPTIONS[EXPERTS]), *cells)) as server:
        print(server.url, flush=True)
        sys.stdin.read()


if __name__ == "__main__":
    main(*sys.argv[1:]) if sys.argv[1:] else serve()
    os._exit(0)  # skips the end of the interpreter, in which renderers crash
