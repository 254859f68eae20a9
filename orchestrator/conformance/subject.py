"""The open task that checks are played on."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from adapters.adjusting import Adjustable, Adjusters
from adapters.contract import ACTION_NAMES, AdapterError, FloatArray, Image, Simulation, Simulator, TaskCard
from orchestrator.conformance.findings import CannotOpen
from orchestrator.perturbations.references import ReferenceLooks
from suites.vocabulary import CAMERAS, Condition, RenderProfile, View

SIZE = 96
VIEW = View(CAMERAS, SIZE, RenderProfile.FAST)
STEP, TURN = 0.02, 0.05
"""Scale of the actions that are drawn (m, rad), where the simulation accepts as much."""
CLEAN = Condition()


@dataclass(frozen=True)
class Start:
    """How an episode starts."""

    state: str
    """State hash."""
    images: Mapping[str, Image]
    picture: Image


class Subject:
    """A task under check. Opened when it is first needed, and then shared by all checks: each begins with a reset."""

    def __init__(
        self, simulator: Simulator, task: str, view: View = VIEW, loaded_by_declaring: frozenset[str] = frozenset()
    ) -> None:
        """Of a simulator.

        Args:
            simulator: As it is declared.
            task: One of its tasks, by its name there.
            view: What to render.
            loaded_by_declaring: Modules that were imported when the entry point was loaded.
        """
        self.simulator, self._short, self.view = simulator, task, view
        self.loaded_by_declaring = loaded_by_declaring
        self.opening_s: float | None = None
        """What opening took, once it was."""
        self.references = ReferenceLooks()
        """What the clean episode shows, for perturbations that are measured against it."""
        self._starts: dict[int, Start] = {}

    @property
    def task(self) -> str:
        """`simulator/task`."""
        return f"{self.simulator.name}/{self._short}"

    @property
    def card(self) -> TaskCard:
        """What the simulator says of the task."""
        return self.simulator.tasks[self._short]

    @cached_property
    def _outcome(self) -> Simulation | Exception:
        began = time.perf_counter()
        try:
            simulation = self.open()
            simulation.reset(0, CLEAN)
        except Exception as error:  # an adapter may raise anything; the check `opens` tells it
            return error
        self.opening_s = time.perf_counter() - began
        return simulation

    @property
    def why_not_open(self) -> Exception | None:
        """What opening raised, if it did."""
        return self._outcome if isinstance(self._outcome, Exception) else None

    @property
    def simulation(self) -> Simulation:
        """The open task.

        Raises:
            CannotOpen: It cannot be opened.
        """
        if isinstance(self._outcome, Exception):
            raise CannotOpen from self._outcome
        return self._outcome

    def open(self) -> Simulation:
        """Open the task once more. Whoever does so closes it."""
        return self.simulator.open(self._short, self.view)

    @contextmanager
    def another(self) -> Iterator[Simulation]:
        """The task, opened once more for a while."""
        simulation = self.open()
        try:
            yield simulation
        finally:
            simulation.close()

    @property
    def adjusters(self) -> Adjusters:
        """What of the open task's world can be adjusted."""
        return self.simulation.adjusters if isinstance(self.simulation, Adjustable) else Adjusters()

    def reset(self, seed: int = 0) -> Simulation:
        """The open task at the start of an episode."""
        self.simulation.reset(seed, CLEAN)
        return self.simulation

    def start(self, seed: int) -> Start:
        """How the episode of a seed starts, as it did when it was first asked for. Resets, if it was not."""
        if seed not in self._starts:
            simulation = self.reset(seed)
            images = {camera: image.copy() for camera, image in simulation.observe().images.items()}
            self._starts[seed] = Start(simulation.state_hash(), images, simulation.picture().copy())
        return self._starts[seed]

    def differences(self, start: Start, *, picture: bool = True) -> Iterator[str]:
        """What is not as at a start, now."""
        simulation = self.simulation
        if (state := simulation.state_hash()) != start.state:
            yield f"state hash {state} instead of {start.state}"
        after = simulation.observe().images
        if other := [camera for camera, image in start.images.items() if (after[camera] != image).any()]:
            yield f"other images of {', '.join(other)}"
        elif picture and (simulation.picture() != start.picture).any():
            yield "another picture"

    def ignores(self, name: str) -> bool:
        """Whether a dimension of actions is declared to have no effect."""
        return name in self.simulation.action_spec.ignored

    def action(self, **values: float) -> FloatArray:
        """An action (7,) with an open gripper, and these of its numbers by name."""
        action = np.zeros(len(ACTION_NAMES))
        action[-1] = -1.0
        for name, value in values.items():
            action[ACTION_NAMES.index(name)] = value
        return action

    def random_actions(self, seed: int, count: int) -> FloatArray:
        """Actions (count, 7) that are drawn evenly from a seed, within the bounds."""
        scale = np.minimum([STEP] * 3 + [TURN] * 3 + [1.0], self.simulation.action_spec.high)
        return np.random.default_rng(seed).uniform(-1.0, 1.0, (count, len(ACTION_NAMES))) * scale

    def close(self) -> None:
        """Close the task if it is open."""
        if "_outcome" in self.__dict__ and not isinstance(self._outcome, Exception):
            self._outcome.close()


def describe(error: BaseException) -> str:
    """An exception in a line. Errors that adapters raise on purpose speak for themselves."""
    text = (str(error).splitlines() or ["no message"])[0]
    return text if isinstance(error, AdapterError) else f"{type(error).__name__}: {text}"


def exact(state: Mapping[str, FloatArray]) -> str:
    """A privileged state to the bit."""
    return b"".join(np.asarray(state[name], np.float64).tobytes() for name in sorted(state)).hex()


def changed(before: Image, after: Image, by: int = 8) -> float:
    """Share of the pixels of two images that differ by more than this in some channel."""
    return float((np.abs(before.astype(int) - after).max(axis=2) > by).mean())
