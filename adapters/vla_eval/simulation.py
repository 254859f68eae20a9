"""One task of a benchmark of vla-evaluation-harness, by its class.

Resets, physics, rendering and success are the class's own; what it gets for an action is what its runner would send.
"""

from __future__ import annotations

import hashlib
import random
import sys
from collections.abc import Callable, Coroutine, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np

from robogauntlet.adapters.base_simulation import BaseSimulation
from robogauntlet.adapters.contract import (
    AdapterError,
    FloatArray,
    Image,
    Observation,
    SimulatorUnavailable,
    StepOutcome,
    TaskUnavailable,
)
from robogauntlet.adapters.frames import hash_state
from robogauntlet.adapters.vla_eval.benchmark import Benchmark
from robogauntlet.suites.episode import View
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.support.errors import first_line
from robogauntlet.support.text import first_of

SHOWN = 5
"""Names in a message."""
EPISODE, WORDS, IMAGES = "episode_idx", "task_description", "images"
"""Keys of a task and of an observation in the harness."""


class BenchmarkSimulation(BaseSimulation):
    """One task of a benchmark, see `robogauntlet.adapters.contract.Simulation`.

    A seed is the class's `episode_idx`. It also seeds the generators of Python, NumPy and torch that classes draw from,
    and an environment of gymnasium that the class resets without a seed.
    """

    def __init__(self, benchmark: Benchmark, task: str, instruction: str, view: View) -> None:
        """Make the class and start its first episode, which opens the simulator.

        Raises:
            SimulatorUnavailable: There is no such class, its simulator is missing, or its action is of other numbers.
            TaskUnavailable: The class has no such task, or nobody says its goal.
        """
        super().__init__(view, instruction, benchmark.action_spec)
        self._declared = benchmark
        self._generators = _Generators()
        self._seed = 0
        with missing_packages(benchmark.path):
            with self._generators.own():
                self._benchmark = make(benchmark.path, benchmark.arguments)
                check_action(self._benchmark, benchmark)
                self._task = task_of(self._benchmark, task)
            self._start()  # what is drawn only when the simulator is opened is no part of an episode
            _seed_environments(self._benchmark, lambda: self._seed)
            self.reset(0)

    def reset(self, seed: int) -> None:
        """Start the class's episode of this number.

        Raises:
            AdapterError: Its sentence is another than declared.
            TaskUnavailable: It says no sentence, and none is declared.
        """
        self._seed = seed
        self._generators.seed(seed)
        self._start()
        said = self._sentence()
        if not said and not self.instruction:
            raise TaskUnavailable(f"{self._name}: expected a sentence as {WORDS}, got none; declare it in tasks")
        if said and self.instruction and not self._declared.own_words and said != self.instruction:
            raise AdapterError(
                f"{self._name}: expected '{self.instruction}' as declared, its class says '{said}'; declare that, or "
                "own_words=True"
            )

    def _start(self) -> None:
        self._outcome = StepOutcome(0.0, False)
        self._task = {**self._task, EPISODE: self._seed}
        with self._generators.own():
            result_of(self._benchmark.start_episode(self._task))
            self._seen = result_of(self._benchmark.get_observation())

    def step(self, action: FloatArray) -> StepOutcome:
        """Apply an action, clipped to its bounds. After the class's end of an episode nothing happens."""
        if self._outcome.terminated:
            return self._outcome
        given = np.clip(action, self.action_spec.low, self.action_spec.high)
        with self._generators.own():
            result = self._benchmark.step({"actions": given})
            done = bool(self._benchmark.check_done(result))
            found = self._benchmark.get_step_result(result)
            self._seen = self._benchmark.make_obs(result.obs, self._task)
        if "success" not in found:
            raise AdapterError(f"{self._name}: expected success in its result, got {first_of([*found], SHOWN)}")
        self._outcome = StepOutcome(float(result.reward), bool(found["success"]), done)
        return self._outcome

    def observe(self) -> Observation:
        """Return what the class showed last, with its own sentence if it says one."""
        seen = super().observe()
        return Observation(seen.images, seen.proprioception, self._sentence() or self.instruction, native=seen.native)

    def draw(self, camera: str, size: int) -> Image:
        """Return a camera's image (size, size, 3), as the class made it if it has that size, else scaled, with bars."""
        images, name = self._seen.get(IMAGES) or {}, self._declared.cameras[camera]
        if name not in images:
            got = first_of([*images], SHOWN) or "none"
            raise AdapterError(f"{self._name}: expected an image '{name}', as cameras says, got {got}")
        image = np.asarray(images[name])
        if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
            got = f"shape {image.shape}, {image.dtype}"
            raise AdapterError(f"{self._name}: expected an image of bytes, (height, width, 3), as '{name}', got {got}")
        if image.shape[:2] == (size, size):
            return image.copy()
        from PIL import Image as Pillow, ImageOps

        return np.array(ImageOps.pad(Pillow.fromarray(image), (size, size), Pillow.Resampling.BILINEAR))

    def privileged_state(self) -> Mapping[str, FloatArray]:
        """Return proprioception, and the action that is declared to move nothing."""
        parts = [np.ravel(self._seen.get(key, ())).astype(np.float64) for key in self._declared.state]
        for (key, size), part in zip(self._declared.state.items(), parts, strict=True):
            if len(part) != size:
                raise AdapterError(f"{self._name}: expected {size} numbers as '{key}', as state says, got {len(part)}")
        still = [part.still for part in self._declared.action.values() for _ in range(part.size)]
        return {"state": np.concatenate([np.zeros(0), *parts]), "still": np.array(still)}

    def state_hash(self) -> str:
        """Hash what the class shows, reward and success, since the harness gives no state of the engine."""
        images = self._seen.get(IMAGES) or {}
        pixels = b"".join(np.ascontiguousarray(images[name]).tobytes() for name in sorted(images))
        numbers = {
            str(key): value
            for key, value in self._seen.items()
            if isinstance(value, np.ndarray) and value.dtype.kind in "biuf"
        }
        outcome = np.array([self._outcome.reward, self._outcome.success, self._outcome.terminated], np.float64)
        shown = np.frombuffer(hashlib.sha256(pixels).digest(), np.uint8).astype(np.float64)
        return hash_state({**numbers, "outcome": outcome, "images": shown})

    def render_device(self) -> str:
        """Return the class, which draws."""
        return f"images of {self._declared.path}"

    def close(self) -> None:
        """Let the class release what it holds."""
        self._benchmark.cleanup()

    @property
    def _name(self) -> str:
        return f"{self._declared.path}, task '{self._task['name']}'"

    def _sentence(self) -> str:
        return " ".join(str(self._seen.get(WORDS) or "").split())


def make(path: str, arguments: Mapping[str, Any]) -> Any:
    """Return the benchmark of a class, `MODULE:CLASS`.

    Raises:
        SimulatorUnavailable: There is no such class, it is no `StepBenchmark`, or it does not take these arguments.
    """
    from vla_eval.benchmarks.base import StepBenchmark

    module, _, name = path.partition(":")
    try:
        loaded = import_module(module)
    except ModuleNotFoundError as error:
        if not error.name or not f"{module}.".startswith(f"{error.name}."):
            raise
        raise SimulatorUnavailable(f"{path}: expected a module of this name in {sys.executable}, found none") from None
    known = [key for key, one in vars(loaded).items() if isinstance(one, type) and issubclass(one, StepBenchmark)]
    if name not in vars(loaded):
        raise SimulatorUnavailable(f"{path}: no such class in that module{did_you_mean(name, known)}")
    if name not in known:
        raise SimulatorUnavailable(
            f"{path}: expected a StepBenchmark of vla-eval, got {type(vars(loaded)[name]).__name__}"
        )
    try:
        return vars(loaded)[name](**arguments)
    except (TypeError, ValueError) as error:
        raise SimulatorUnavailable(f"{path}: it does not take these arguments: {first_line(error)}") from None


def task_of(benchmark: Any, name: str) -> dict[str, Any]:
    """Return the class's task of this name. Raises TaskUnavailable if it has none or several."""
    tasks = benchmark.get_tasks()
    found = [task for task in tasks if task.get("name") == name]
    if len(found) != 1:
        names = [str(task.get("name")) for task in tasks]
        said = f"{len(found)} of them" if found else f"none{did_you_mean(name, names)}"
        raise TaskUnavailable(f"{type(benchmark).__name__}: expected one task '{name}', it has {said}")
    return dict(found[0])


def action_parts(benchmark: Any) -> list[tuple[str, Any]]:
    """Return the class's parts of an action, by name; none if it does not say them."""
    try:
        return list(benchmark.get_action_spec().items())
    except NotImplementedError:
        return []


def check_action(benchmark: Any, declared: Benchmark) -> None:
    """Compare the parts of an action with those declared. Raises SimulatorUnavailable if they differ."""
    theirs = {name: part.dims for name, part in action_parts(benchmark)}
    ours = {name: part.size for name, part in declared.action.items()}
    sizes = {name: size or ours.get(name) for name, size in theirs.items()}
    if theirs and list(ours.items()) != list(sizes.items()):
        wanted, got = (", ".join(f"{name} of {size}" for name, size in some.items()) for some in (ours, theirs))
        raise SimulatorUnavailable(f"{declared.path}: expected an action of {wanted}, as declared, the class has {got}")


@contextmanager
def missing_packages(path: str) -> Iterator[None]:
    """Say in one line which module a class lacks. Raises SimulatorUnavailable."""
    try:
        yield
    except ImportError as error:
        raise SimulatorUnavailable(
            f"{path} cannot import what it needs in {sys.executable}: {first_line(error)}; install it there, or say in "
            "which environment it is (requirements=, or interpreter in config.yaml)"
        ) from None


def result_of(coroutine: Coroutine[Any, Any, Any]) -> Any:
    """Return what a coroutine of a `StepBenchmark` returns, which waits for nothing; so it needs no event loop."""
    try:
        coroutine.send(None)
    except StopIteration as finished:
        return finished.value
    coroutine.close()
    raise AdapterError("expected a StepBenchmark, whose methods do not wait; this one does")


def _seed_environments(benchmark: Any, seed: Callable[[], int]) -> None:
    """Give a seed to each reset without one of the environments of gymnasium that a benchmark holds."""
    if "gymnasium" not in sys.modules:
        return
    from gymnasium import Env

    for one in vars(benchmark).values():
        if isinstance(one, Env):
            vars(one)["reset"] = partial(_reset, one.reset, seed)


def _reset(reset: Callable[..., Any], seed: Callable[[], int], **given: Any) -> Any:
    return reset(**{**given, "seed": seed() if given.get("seed") is None else given["seed"]})


class _Generators:
    """The global generators of Python, NumPy and torch as a simulation sees them; outside, they are as they were."""

    def __init__(self) -> None:
        self._states: list[Any] | None = None
        self.seed(0)

    def seed(self, seed: int) -> None:
        """Begin anew."""
        self._seed, self._states = seed, None

    @contextmanager
    def own(self) -> Iterator[None]:
        """Use the own states in a block."""
        before = self._now()
        if self._states is None:
            random.seed(self._seed)
            np.random.seed(self._seed % 2**32)
            if torch := sys.modules.get("torch"):
                torch.manual_seed(self._seed)
        else:
            self._set(self._states)
        try:
            yield
        finally:
            self._states = self._now()
            self._set(before)

    def _now(self) -> list[Any]:
        torch = sys.modules.get("torch")
        return [random.getstate(), np.random.get_state(), torch.get_rng_state() if torch else None]

    def _set(self, states: list[Any]) -> None:
        python, numpy, of_torch = states
        random.setstate(python)
        np.random.set_state(numpy)
        if of_torch is not None:
            sys.modules["torch"].set_rng_state(of_torch)
