"""A gymnasium environment by its mapping (see `robogauntlet.adapters.gymnasium.mapping`).

Physics, rendering and success are those of the environment; the mapping only names its numbers. Whether equal seeds
give equal episodes depends on the environment; the conformance checks test it.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from copy import copy
from typing import Any

import numpy as np

from robogauntlet.adapters.base_simulation import BaseSimulation
from robogauntlet.adapters.contract import FloatArray, Image, StepOutcome, TaskUnavailable
from robogauntlet.adapters.frames import hash_state
from robogauntlet.adapters.gymnasium.mapping import EnvironmentMapping, Moment
from robogauntlet.adapters.mujoco_scene import MujocoScene, drawing_device, mujoco_state
from robogauntlet.suites.episode import View


class GymnasiumSimulation(BaseSimulation):
    """One environment, see `robogauntlet.adapters.contract.Simulation`."""

    def __init__(self, mapping: EnvironmentMapping, view: View) -> None:
        """Make the environment.

        Raises:
            SimulatorUnavailable: This machine cannot render.
            TaskUnavailable: gymnasium cannot make it.
        """
        super().__init__(view, mapping.instruction, mapping.action_spec)
        self._mapping, self._env = mapping, _make(mapping)
        world = self._world = mapping.opened(self._env.unwrapped)
        is_mujoco = hasattr(world, "model") and hasattr(world, "data")
        self._scene = MujocoScene(world.model, world.data, view.render_profile) if is_mujoco else None
        if self._scene:
            self.culling = True
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Start the episode of `seed`, from which the environment draws its state."""
        self._moment = Moment(self._world, *self._env.reset(seed=seed))
        self._ended: StepOutcome | None = None

    def step(self, action: FloatArray) -> StepOutcome:
        """Apply `action`, of the mapping's `action_spec`, for one step. The reward is the environment's.

        The episode ends where the environment says `terminated`, or `truncated` by a limit of its own, since gymnasium
        does not say what a step after either does. It stays as it ended.
        """
        if self._ended:
            return self._ended
        command = self._mapping.action(np.clip(action, self.action_spec.low, self.action_spec.high))
        dtype = self._env.action_space.dtype
        observation, reward, terminated, truncated, info = self._env.step(np.asarray(command).astype(dtype))
        self._moment = Moment(self._world, observation, info, float(reward), bool(terminated), command)
        success, over = self._mapping.success(self._moment), bool(terminated or truncated)
        if over:
            self._ended = StepOutcome(0.0, success, terminated=True)
        return StepOutcome(float(reward), success, over)

    def privileged_state(self) -> Mapping[str, FloatArray]:
        """Return the state that the mapping describes, in the base frame."""
        return self._mapping.observe(self._moment)

    def state_hash(self) -> str:
        """Hash the observation and, in MuJoCo, the physical state."""
        from gymnasium.spaces import flatten

        seen = {"observation": flatten(self._env.observation_space, self._moment.observation)}
        return hash_state(seen | (mujoco_state(self._world.model, self._world.data) if self._scene else {}))

    def draw(self, camera: str, size: int) -> Image:
        """Render a camera of the mapping, (size, size, 3)."""
        if self._scene is None:
            return self._mapping.image(self._moment, size)
        world, data = self._world, self._world.data
        # gymnasium-robotics' callback, which places the goal's marker relative to the site's last pose, changes more.
        world.data, sites = copy(data), world.model.site_pos.copy()
        try:
            getattr(world, "_render_callback", bool)()
            source = self._mapping.camera(camera, self._moment)
            return self._scene.image(source, size, data=world.data, culling=self.culling)
        finally:
            world.data, world.model.site_pos[:] = data, sites

    def render_device(self) -> str:
        """Return OpenGL's name of the renderer, which is unknown for an environment's own `render`."""
        self.draw("third_person", self.view.image_size)
        return drawing_device() if self._scene else f"render of {self._mapping.env}"

    def close(self) -> None:
        """Close environment and renderers."""
        if self._scene:
            self._scene.close()
        self._env.close()


def _make(mapping: EnvironmentMapping) -> Any:
    """Make the environment, without a time limit of gymnasium's wrappers: the horizon is the suite's."""
    os.environ.setdefault("MUJOCO_GL", "egl")
    import gymnasium

    try:
        return gymnasium.make(mapping.env, disable_env_checker=True, max_episode_steps=-1, **mapping.make)
    except Exception as error:  # A constructor may raise anything.
        raise TaskUnavailable(f"gymnasium cannot make '{mapping.env}': {' '.join(str(error).split())}") from error
