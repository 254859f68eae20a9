"""Any gymnasium environment that a mapping file describes (see `robogauntlet.adapters.gymnasium.mapping`).

Physics, rendering and success are those of the environment; the mapping only names its numbers. Whether equal seeds
give equal episodes depends on the environment; the conformance checks test it.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from typing import Any

import numpy as np

from robogauntlet.adapters.base_simulation import BaseSimulation
from robogauntlet.adapters.contract import (
    ACTION_DIM,
    AdapterError,
    FloatArray,
    Image,
    SimulatorUnavailable,
    StepOutcome,
    TaskUnavailable,
)
from robogauntlet.adapters.frames import hash_state
from robogauntlet.adapters.gymnasium.expressions import value_of
from robogauntlet.adapters.gymnasium.mapping import (
    FILES,
    EnvironmentMapping,
    Orbit,
    load_mapping,
)
from robogauntlet.adapters.gymnasium.mapping_checks import (
    action_map,
    action_spec,
    check_camera,
    check_state,
    in_base_frame,
    is_mujoco,
    make,
    scaled,
)
from robogauntlet.adapters.mujoco_scene import MujocoScene, drawing_device, mujoco_state, orbit_camera
from robogauntlet.suites.episode import View


class GymnasiumSimulation(BaseSimulation):
    """One environment, see `robogauntlet.adapters.contract.Simulation`."""

    def __init__(self, mapping: EnvironmentMapping, view: View) -> None:
        """Make the environment and take one step in it.

        Raises:
            ValueError: The mapping does not fit the environment.
        """
        super().__init__(view, mapping.instruction, action_spec(mapping))
        self._mapping, self._env = mapping, make(mapping)
        world = self._world = self._env.unwrapped
        self._scene = MujocoScene(world.model, world.data, view.render_profile) if is_mujoco(world) else None
        if self._scene:
            self.culling = True
        self._gain, self._offset = action_map(mapping, self._env.action_space)
        for camera in view.cameras:
            check_camera(camera, mapping, self._world)
        self.reset(0)
        self.step(np.zeros(ACTION_DIM))
        check_state(mapping, self.privileged_state())

    def reset(self, seed: int) -> None:
        """Start the episode of `seed`, from which the environment draws its state."""
        observation, info = self._env.reset(seed=seed)
        self._outcome = {"observation": observation, "info": info, "reward": 0.0, "terminated": False}
        self._ended: StepOutcome | None = None

    def step(self, action: FloatArray) -> StepOutcome:
        """Apply `action` (7,) for one step. The reward is the environment's.

        The episode ends where the environment says `terminated`, or `truncated` by a limit of its own, since gymnasium
        does not say what a step after either does. It stays as it ended.
        """
        if self._ended:
            return self._ended
        command = self._gain @ np.clip(action, self.action_spec.low, self.action_spec.high) + self._offset
        observation, reward, terminated, truncated, info = self._env.step(command.astype(self._env.action_space.dtype))
        self._outcome = {"observation": observation, "info": info, "reward": reward, "terminated": terminated}
        success, over = bool(np.all(self._value(self._mapping.success))), bool(terminated or truncated)
        if over:
            self._ended = StepOutcome(0.0, success, terminated=True)
        return StepOutcome(float(reward), success, over)

    def privileged_state(self) -> Mapping[str, FloatArray]:
        """Return the state that the mapping describes, in the base frame."""
        return {name: self._read(name, source) for name, source in self._mapping.state.items()}

    def state_hash(self) -> str:
        """Hash the observation and, in MuJoCo, the physical state."""
        from gymnasium.spaces import flatten

        seen = {"observation": flatten(self._env.observation_space, self._outcome["observation"])}
        return hash_state(seen | (mujoco_state(self._world.model, self._world.data) if self._scene else {}))

    def draw(self, camera: str, size: int) -> Image:
        """Render a camera of the mapping, (size, size, 3); images of `render` are cropped to a square and scaled."""
        source = getattr(self._mapping.cameras, camera)
        if self._scene is None:
            return scaled(self._env.render(), size)
        world, data = self._world, self._world.data
        # gymnasium-robotics' callback, which places the goal's marker relative to the site's last pose, changes more.
        world.data, sites = copy(data), world.model.site_pos.copy()
        try:
            getattr(world, "_render_callback", bool)()
            if isinstance(source, Orbit):
                at = self._value(source.at) if isinstance(source.at, str) else source.at
                source = orbit_camera(at, source.distance, source.azimuth, source.elevation)
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

    def _value(self, expression: str) -> Any:
        return value_of(expression, {**self._outcome, "unwrapped": self._world}, self._mapping.reads)

    def _read(self, name: str, source: Any) -> FloatArray:
        """Return one entry of the state."""
        parts = source if isinstance(source, list) else [source]
        values = [self._value(part) if isinstance(part, str) else part for part in parts]
        value = np.concatenate([np.ravel(value).astype(np.float64) for value in values])
        plain = not any(isinstance(part, str) for part in parts)
        return value if plain else in_base_frame(name, value, self._mapping)


def open_environment(task: str, view: View) -> GymnasiumSimulation:
    """Open the environment of a mapping file.

    Raises:
        SimulatorUnavailable: This machine cannot render.
        TaskUnavailable: A package is missing, the file has mistakes, or it does not fit the environment; the message
            has a line for each. Tasks of other files can be played.
    """
    try:
        return GymnasiumSimulation(load_mapping(FILES[task]), view)
    except ValueError as error:
        raise TaskUnavailable(f"{FILES[task]}: {error}") from error
    except SimulatorUnavailable:
        raise
    except AdapterError as error:
        raise TaskUnavailable(str(error)) from error
