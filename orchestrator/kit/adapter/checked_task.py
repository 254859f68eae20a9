"""The open task on which checks run."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from robogauntlet.adapters.contract import (
    ACTION_NAMES,
    ARM_PREFIXES,
    AdapterError,
    FloatArray,
    Image,
    Simulation,
    Simulator,
    StepOutcome,
    TaskDescription,
)
from robogauntlet.adapters.motion import standing_still
from robogauntlet.adapters.scene_control import SceneControls, scene_controls_of
from robogauntlet.orchestrator.perturbations.base import ReferenceImages
from robogauntlet.suites.episode import CAMERAS, RenderProfile, View
from robogauntlet.support import errors

SIZE = 96
VIEW = View(CAMERAS, SIZE, RenderProfile.FAST)
STEP, TURN = 0.02, 0.05
"""Scale of random actions (m, rad), where the simulation accepts as much."""
SINGULAR = 1e-3
"""Share of the largest translation for a radian below which an arm cannot move its tool in a direction."""


class CannotOpen(Exception):
    """The task cannot be opened: the check `opens` reports it, the others are skipped."""


class EpisodeOver(Exception):
    """The simulation has ended the episode, as StepOutcome.terminated says: the check that goes on is skipped."""


@dataclass(frozen=True)
class Start:
    """The start of an episode."""

    seed: int
    state: str
    """State hash."""
    images: Mapping[str, Image]
    picture: Image


class CheckedTask:
    """A task that is opened at first use and shared by all checks, each of which begins with a reset."""

    def __init__(
        self, simulator: Simulator, task: str, view: View = VIEW, loaded_by_declaring: frozenset[str] = frozenset()
    ) -> None:
        """Take a task by its name in the simulator."""
        self.simulator, self._short, self.view = simulator, task, view
        self.loaded_by_declaring = loaded_by_declaring
        """Modules that loading the entry point imported."""
        self.opening_s: float | None = None
        """Time that opening took, once it is open."""
        self.references = ReferenceImages()
        """Images of clean episodes, with which perturbations are compared."""
        self._starts: dict[int, Start] = {}

    @property
    def task(self) -> str:
        """`simulator/task`."""
        return f"{self.simulator.name}/{self._short}"

    @property
    def description(self) -> TaskDescription:
        """The task, as the simulator declares it."""
        return self.simulator.tasks[self._short]

    @cached_property
    def _outcome(self) -> Simulation | Exception:
        began = time.perf_counter()
        try:
            simulation = self.open()
            simulation.reset(0)
        except Exception as error:  # an adapter may raise anything; the check `opens` reports it
            return error
        self.opening_s = time.perf_counter() - began
        return simulation

    @property
    def simulation(self) -> Simulation:
        """The open task; raises CannotOpen from the error of opening it."""
        if isinstance(self._outcome, Exception):
            raise CannotOpen from self._outcome
        return self._outcome

    def open(self) -> Simulation:
        """Open the task once more; the caller closes it. A step after the end of an episode raises EpisodeOver."""
        return _never_stepped_past_its_end(self.simulator.open(self._short, self.view))

    @property
    def scene_controls(self) -> SceneControls:
        """The scene controls of the open task."""
        return scene_controls_of(self.simulation)

    def reset(self, seed: int = 0) -> Simulation:
        """Start an episode of the open task."""
        self.simulation.reset(seed)
        return self.simulation

    def start(self, seed: int) -> Start:
        """Return the start of a seed's episode, recorded at the first call, which resets."""
        if seed not in self._starts:
            simulation = self.reset(seed)
            images = {camera: image.copy() for camera, image in simulation.observe().images.items()}
            self._starts[seed] = Start(seed, simulation.state_hash(), images, simulation.picture().copy())
        return self._starts[seed]

    def differences(self, start: Start, *, picture: bool = True) -> Iterator[str]:
        """Yield how the simulation differs from a start now."""
        simulation = self.simulation
        if (state := simulation.state_hash()) != start.state:
            yield f"state hash {state} instead of {start.state}"
        after = simulation.observe().images
        if other := [camera for camera, image in start.images.items() if (after[camera] != image).any()]:
            yield f"other images of {', '.join(other)}"
        elif picture and (simulation.picture() != start.picture).any():
            yield "another picture"

    @property
    def arms(self) -> tuple[str, ...]:
        """What the names of each arm's numbers begin with."""
        return ARM_PREFIXES[: self.simulation.action_spec.arms]

    def ignores(self, name: str) -> bool:
        """Return whether an action dimension is declared to have no effect."""
        return name in self.simulation.action_spec.ignored

    def length(self, wanted: float) -> float:
        """A translation of the tool (m), shortened to what the simulation accepts in a step."""
        spec = self.simulation.action_spec
        return wanted if spec.joints or spec.numbers else min(wanted, spec.max_translation)

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """The bounds of an action; of numbers without, some beside the present."""
        spec, still = self.simulation.action_spec, self.action()
        low, high = spec.low, spec.high
        return np.where(np.isfinite(low), low, still - 1.0), np.where(np.isfinite(high), high, still + 1.0)

    def action(self, **values: float) -> FloatArray:
        """An action with open grippers and the given numbers; joints move as far as the tool would be moved."""
        spec = self.simulation.action_spec
        still = standing_still(self.simulation)
        action = np.array([values.get(name, own) for name, own in zip(spec.names, still.tolist(), strict=True)])
        for number, arm in enumerate(self.arms if spec.joints else ()):
            if (way := [values.get(arm + name, 0.0) for name in ACTION_NAMES[:3]]) != [0.0, 0.0, 0.0]:
                turns = np.linalg.pinv(self.simulation.privileged_state()[f"{arm}tcp_jacobian"][:3]) @ way
                action[spec.joints_of(number)] += spec.per_radian * turns
        return action

    def moving(self, **values: float) -> FloatArray:
        """The same for a translation, or for one as long that the arm can make: a planar arm stays in its plane.

        Native numbers go half the way to their farther bounds.
        """
        spec, names = self.simulation.action_spec, ACTION_NAMES[:3]
        if spec.numbers:
            still, (low, high) = self.action(), self.bounds()
            return np.where(high - still > still - low, (still + high) / 2, (still + low) / 2)
        way = np.array([values.get(name, 0.0) for name in names])
        length = float(np.linalg.norm(way))
        if spec.joints:
            directions, sizes, _ = np.linalg.svd(self.simulation.privileged_state()["tcp_jacobian"][:3])
            able = directions[:, : len(sizes)][:, sizes > SINGULAR * sizes[0]]
            upwards = 1.0 if directions[2, 0] >= 0.0 else -1.0
            possible, other = able @ able.T @ way, upwards * length * directions[:, 0]
        else:
            able = np.array([not self.ignores(name) for name in names])
            possible, other = able * way, length * (np.arange(3) == int(able.argmax()))
        way = possible if np.linalg.norm(possible) >= 0.5 * length else other
        return self.action(**dict(zip(names, way.tolist(), strict=True)))

    def random_actions(self, seed: int, count: int) -> FloatArray:
        """Actions, one in each of `count` rows, drawn uniformly within the bounds.

        Targets of joints walk at random from the present ones.
        """
        spec, generator = self.simulation.action_spec, np.random.default_rng(seed)
        if spec.numbers:
            return generator.uniform(*self.bounds(), (count, len(spec.numbers)))
        if spec.joints:
            drawn, still = generator.uniform(-1.0, 1.0, (count, len(spec.names))), self.action()
            for there in map(spec.joints_of, range(spec.arms)):
                turns = spec.per_radian * TURN * drawn[:, there]
                drawn[:, there] = turns if spec.velocities else still[there] + np.cumsum(turns, axis=0)
            return np.clip(drawn, spec.low, spec.high)
        scale = np.minimum(([STEP] * 3 + [TURN] * 3 + [1.0]) * spec.arms, spec.high)
        return generator.uniform(-1.0, 1.0, (count, len(scale))) * scale

    def close(self) -> None:
        """Close the task if it is open."""
        if "_outcome" in self.__dict__ and not isinstance(self._outcome, Exception):
            self._outcome.close()


def _never_stepped_past_its_end(simulation: Simulation) -> Simulation:
    """Return the simulation, whose `step` raises EpisodeOver between the end of an episode and the next reset."""
    reset, step, over = simulation.reset, simulation.step, False

    def reset_first(seed: int) -> None:
        nonlocal over
        over = False
        reset(seed)

    def step_if_not_over(action: FloatArray) -> StepOutcome:
        nonlocal over
        if over:
            raise EpisodeOver
        outcome = step(action)
        over = getattr(outcome, "terminated", False) is True
        return outcome

    vars(simulation).update(reset=reset_first, step=step_if_not_over)
    return simulation


def describe(error: BaseException) -> str:
    """Describe an exception in one line; an AdapterError by its message alone."""
    return errors.first_line(error) if isinstance(error, AdapterError) else errors.describe(error)


def changed(before: Image, after: Image, by: int = 8) -> float:
    """Share of the pixels of two images that differ by more than this in some channel."""
    return float((np.abs(before.astype(int) - after).max(axis=2) > by).mean())


def most_changed(before: Mapping[str, Image], after: Mapping[str, Image], by: int = 8) -> float:
    """The largest share of changed pixels of any camera."""
    return max(changed(before[camera], after[camera], by) for camera in before)
