"""A simulation as an environment of gymnasium."""

from __future__ import annotations

import string
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from robogauntlet.adapters.contract import FloatArray, Image, Simulation, TaskDescription
from robogauntlet.orchestrator.perturbations import perturbed
from robogauntlet.orchestrator.perturbations.base import PerturbedSimulation, ReferenceImages
from robogauntlet.suites.episode import Cell

MAX_INSTRUCTION = 200


class TaskEnvironment(gymnasium.Env[dict[str, Any], FloatArray]):
    """A task whose every step returns the images.

    Attributes:
        observation_space: `images` (camera to (size, size, 3) uint8), `proprioception` (float64) and `instruction`
            (text).
        action_space: (7,), for two arms (14,), a number for each joint and the gripper, or native ones; float64 in the
            units of `robogauntlet.adapters.contract`; what is beyond is clipped, as in a run.
        simulation: The simulation of the episode, with the true state.
        horizon: Control steps after which an episode is truncated.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"]}  # noqa: RUF012 (gymnasium declares it so)

    def __init__(
        self, simulation: Simulation, description: TaskDescription, cell: Cell, render_mode: str | None = None
    ) -> None:
        """See `robogauntlet.make`.

        Args:
            simulation: The clean simulation of the task.
            description: Its description.
            cell: Condition and protocol of the episodes.
            render_mode: `rgb_array` or None.
        """
        self.simulation = self._clean = simulation
        self.horizon, self.render_mode = cell.protocol.horizon, render_mode
        self._hold = cell.protocol.success_hold
        self._cell, self._references = cell, ReferenceImages()
        spec, view = simulation.action_spec, simulation.observation_spec
        self.metadata = {**self.metadata, "render_fps": spec.control_hz}
        image = spaces.Box(0, 255, (view.image_size, view.image_size, 3), np.uint8)
        words = description.instruction
        longest, characters = max(MAX_INSTRUCTION, len(words)), frozenset(string.printable + words)
        self.observation_space = spaces.Dict(
            {
                "images": spaces.Dict(dict.fromkeys(view.cameras, image)),
                "proprioception": spaces.Box(-np.inf, np.inf, (spec.body.proprioception_dim,), np.float64),
                "instruction": spaces.Text(longest, min_length=0, charset=characters),
            }
        )
        self.action_space = spaces.Box(spec.low, spec.high, dtype=np.float64)
        self._steps: int | None = None
        self._held = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start the episode of a seed, which is the episode of that seed in a run; without one, of a random seed.

        Returns:
            The observation, and a mapping with `seed`.

        Raises:
            NotDelivered: The condition's level was not delivered.
        """
        super().reset(seed=seed)
        chosen = int(self.np_random.integers(2**31)) if seed is None else seed
        self.simulation = perturbed(self._clean, self._cell.episode(chosen), self._references)
        self.simulation.reset(chosen)
        if isinstance(self.simulation, PerturbedSimulation):
            self.simulation.check_start()
        self._steps = self._held = 0
        return self._observe(), {"seed": chosen}

    def step(self, action: FloatArray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Apply one action, of the shape of `action_space`, for one control step.

        Returns:
            The observation; the reward; whether the task has succeeded (its predicate held for five steps in a row, or
            once if that is the rule or the simulation ended), or the simulation has ended otherwise; whether the
            horizon is reached; a mapping with `success` and `success_now`, whether the predicate holds now.

        Raises:
            ValueError: The action has another shape, or is not finite.
            gymnasium.error.ResetNeeded: There was no `reset` before.
        """
        if self._steps is None:
            raise gymnasium.error.ResetNeeded("expected reset before the first step")
        given = np.array(action, dtype=np.float64)
        spec = self.simulation.action_spec
        if given.shape != spec.high.shape or not np.isfinite(given).all():
            raise ValueError(
                f"expected one action of {len(spec.high)} finite numbers, got shape {given.shape}: {given}; "
                "step the actions of a chunk one by one"
            )
        given[spec.ignored_indices] = 0.0
        outcome = self.simulation.step(np.clip(given, spec.low, spec.high))
        self._steps += 1
        self._held = self._held + 1 if outcome.success else 0
        success = self._held >= self._hold or bool(outcome.terminated and outcome.success)
        info = {"success": success, "success_now": bool(outcome.success)}
        over, late = success or bool(outcome.terminated), self._steps >= self.horizon
        return self._observe(), float(outcome.reward), over, late, info

    def render(self) -> Image | None:
        """Return the third-person view, (256, 256, 3) uint8, with `render_mode="rgb_array"`; else None."""
        return self.simulation.picture() if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Free the simulation. Safe to call twice."""
        self._clean.close()

    def _observe(self) -> dict[str, Any]:
        seen = self.simulation.observe()
        return {
            "images": {camera: np.array(image) for camera, image in seen.images.items()},
            "proprioception": np.array(seen.proprioception, dtype=np.float64),
            "instruction": seen.instruction,
        }
