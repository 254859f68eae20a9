"""A gymnasium environment that is not of MuJoCo, and renders only if a render mode is given."""

import gymnasium
import numpy as np


class NoMujoco(gymnasium.Env):
    """Ends with a reward after so many steps, or without one at its limit."""

    def __init__(self, length=1000, limit=1000, render_mode=None):
        self.length, self.limit, self.render_mode, self.steps = length, limit, render_mode, 0
        self.metadata = {"render_modes": ["rgb_array"]} if length < 1000 else {"render_modes": []}
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (1,), np.float64)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        return np.array([self.np_random.uniform()]), {}

    def step(self, action):
        self.steps += 1
        ended = self.steps >= self.length
        return np.array([float(self.steps)]), float(ended), ended, self.steps >= self.limit, {}

    def render(self):
        return np.full((40, 60, 3), self.steps, np.uint8)
