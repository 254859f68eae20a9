"""A task as a benchmark of vla-evaluation-harness and policies as its model server, in the environment of `vla_eval`.

As a program it serves both policies on a free port of the loopback address until its standard input ends.
"""

import json
import os
import sys
import time
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from vla_eval.api import serve_background
from vla_eval.benchmarks.base import StepBenchmark, StepResult
from vla_eval.model_servers.predict import PredictModelServer
from vla_eval.protocol.numpy_codec import set_image_format

from robogauntlet.adapters.contract import Observation
from robogauntlet.policies.catalog import load
from robogauntlet.policies.contract import Query
from robogauntlet.suites.episode import Cell, Protocol
from tests.benchmarks.shared import EXPERT_VIEW, POLICY_OPTIONS, SteppedTask
from tests.benchmarks.vla_eval import VARIANTS

_open = cache(SteppedTask)
"""The task stays open between entries of a configuration, as it does in our workers."""


class GauntletTask(StepBenchmark):
    """A task, whose episodes are the seeds from 0 on. It observes after every step, which the harness sends on."""

    def __init__(self, task: str, policy: str, variant: str, log: str) -> None:
        super().__init__()
        self._name, self._policy, self._variant, self._log = task, policy, variant, Path(log)
        self._played = _open(task, EXPERT_VIEW)
        image_format, culling = VARIANTS[variant]
        set_image_format(image_format)
        if hasattr(self._played.simulation, "culling"):
            self._played.simulation.culling = culling

    def get_tasks(self) -> list[dict[str, Any]]:
        """The one task; the harness adds `episode_idx`."""
        return [{"name": self._name, "policy": self._policy}]

    def get_metadata(self) -> dict[str, Any]:
        """The task's horizon."""
        return {"max_steps": self._played.horizon}

    def reset(self, task: dict[str, Any]) -> Observation:
        """Start the episode."""
        self._seed = task["episode_idx"]
        return self._played.reset(self._seed)

    def step(self, action: dict[str, Any]) -> StepResult:
        """Step and observe."""
        observation, reward = self._played.step(action["actions"].view(np.float64))
        return StepResult(observation, reward, self._played.succeeded or self._played.timed_out, {})

    def make_obs(self, raw_obs: Observation, task: dict[str, Any]) -> dict[str, Any]:
        """The keys that the harness recommends."""
        return {
            "images": dict(raw_obs.images),
            "state": raw_obs.proprioception,
            "task_description": raw_obs.instruction,
        }

    def get_step_result(self, step_result: StepResult) -> dict[str, Any]:
        """The outcome, which is logged with the time."""
        outcome = {"seed": self._seed, "succeeded": self._played.succeeded, "steps": self._played.steps}
        line = {
            "policy": self._policy,
            "variant": self._variant,
            "process": os.getpid(),
            **outcome,
            "ended": time.time(),
        }
        with self._log.open("a") as log:  # one write of one short line
            log.write(json.dumps(line) + "\n")
        return {"success": self._played.succeeded}


class GauntletPolicies(PredictModelServer):
    """All policies of the comparison; the task names the one that acts. Its own buffer holds the rest of a chunk."""

    def __init__(self) -> None:
        self._policies = {kind: load(kind, options) for kind, options in POLICY_OPTIONS.items()}
        super().__init__(chunk_size=Protocol(0).replan_every)
        self._episodes: dict[str, Any] = {}

    async def on_episode_start(self, config: dict[str, Any], ctx: Any) -> None:
        """Start the policy's episode."""
        await super().on_episode_start(config, ctx)
        task = config["task"]
        cell = Cell(task["policy"], task["policy"], task["name"], Protocol(0, view=EXPERT_VIEW))
        self._episodes[ctx.session_id] = episode = cell.episode(task["episode_idx"])
        self._policies[episode.policy].reset([episode])

    def predict(self, obs: dict[str, Any], ctx: Any) -> dict[str, Any]:
        """The policy's chunk. The harness converts numbers to 32 bits, so 64 are sent as two: the same actions."""
        episode = self._episodes[ctx.session_id]
        observation = Observation(obs["images"], obs["state"], obs["task_description"])
        (decision,) = self._policies[episode.policy].act([Query(episode, ctx.step, observation)])
        return {"actions": np.ascontiguousarray(decision.actions, np.float64).view(np.float32)}

    async def on_episode_end(self, result: dict[str, Any], ctx: Any) -> None:
        """End the policy's episode."""
        await super().on_episode_end(result, ctx)
        episode = self._episodes.pop(ctx.session_id)
        self._policies[episode.policy].finish([episode])


if __name__ == "__main__":
    with serve_background(GauntletPolicies()) as server:
        print(server.url, flush=True)
        sys.stdin.read()
