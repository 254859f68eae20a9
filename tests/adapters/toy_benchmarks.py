"""Benchmarks of vla-evaluation-harness: a point that is pushed on a board, and what goes wrong with others."""

import gymnasium
import numpy as np
from gymnasium import spaces
from vla_eval.benchmarks.base import StepBenchmark, StepResult
from vla_eval.specs import GRIPPER_CLOSE_POS, IMAGE_RGB, LANGUAGE, DimSpec

GOALS = {"push left": -0.5, "push right": 0.5}


class Pushes(StepBenchmark):
    """Draws from NumPy's global generator, and ends an episode where the point is at its goal."""

    def __init__(self, places=True, words=True, size=(48, 64)):
        super().__init__()
        self.places, self.words, self.size, self.closed = places, words, size, False
        np.random.random(7)  # what is drawn when it is made is no part of an episode

    def get_tasks(self):
        return [{"name": name, "suite": "toy"} for name in GOALS]

    def get_action_spec(self):
        return {"move": DimSpec("move", 2, "delta_xy", (-1, 1)), "gripper": GRIPPER_CLOSE_POS}

    def get_observation_spec(self):
        return {"front": IMAGE_RGB, "language": LANGUAGE, "places": DimSpec("places", 2, "raw")}

    def get_metadata(self):
        return {"max_steps": 40, "max_episodes_per_task": 50}

    def reset(self, task):
        self.place = np.array([0.0, task["episode_idx"] / 100]) + self._drawn()
        return self.place.copy()

    def _drawn(self):
        return np.random.uniform(-0.1, 0.1, 2)

    def step(self, action):
        given = np.asarray(action["actions"])
        assert given.shape == (3,)
        if given[2] >= 0:
            self.place += 0.1 * given[:2] + np.random.normal(0, 0.001, 2)
        away = abs(self.place[0] - GOALS[self._task["name"]])
        return StepResult(self.place.copy(), -float(away), bool(away < 0.05), {})

    def make_obs(self, raw_obs, task):
        height, width = self.size
        image = np.full((height, width, 3), 200, np.uint8)
        row, column = ((np.clip(raw_obs[::-1], -1, 1) + 1) / 2 * (np.array([height, width]) - 9)).astype(int)
        image[row : row + 8, column : column + 8] = (0, 0, 255)
        seen = {"images": {"front": image}}
        seen |= {"places": raw_obs} if self.places else {}
        return seen | ({"task_description": task["name"]} if self.words else {})

    def get_step_result(self, step_result):
        return {"success": step_result.done}

    def cleanup(self):
        self.closed = True


class OtherWords(Pushes):
    def make_obs(self, raw_obs, task):
        return super().make_obs(raw_obs, task) | {"task_description": f"{task['name']}, {task['episode_idx']} times"}


class Drawn(gymnasium.Env):
    observation_space, action_space = spaces.Box(-1, 1, (2,)), spaces.Box(-1, 1, (2,))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.np_random.uniform(-0.1, 0.1, 2), {}


class HoldsAnEnvironment(Pushes):
    """Resets an environment of gymnasium without a seed."""

    environment = None

    def _drawn(self):
        self.environment = self.environment or Drawn()
        return self.environment.reset()[0]


class NeedsItsSimulator(Pushes):
    def reset(self, task):
        import no_such_simulator  # noqa: F401

        return super().reset(task)


class NoSuccess(Pushes):
    def get_step_result(self, step_result):
        return {"score": 1.0}


class Waits(Pushes):
    async def start_episode(self, task, recorder=None):
        import asyncio

        await asyncio.sleep(0)


class Grey(Pushes):
    def make_obs(self, raw_obs, task):
        return super().make_obs(raw_obs, task) | {"images": {"front": np.zeros((8, 8), np.uint8)}}


def not_a_class():
    """Is none."""
