"""The adapter of benchmarks of vla-evaluation-harness, each by its class. Imports neither it nor a simulator."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from robogauntlet.adapters.contract import Simulation, Simulator, TaskDescription
from robogauntlet.adapters.vla_eval.benchmark import Benchmark, Part
from robogauntlet.suites.episode import CAMERAS, View

__all__ = ["Part", "declare"]


def declare(
    name: str,
    title: str,
    benchmark: str,
    *,
    tasks: Mapping[str, str],
    action: Mapping[str, Part],
    cameras: Mapping[str, str],
    horizon: int,
    control_hz: float,
    state: Mapping[str, int] | None = None,
    arguments: Mapping[str, Any] | None = None,
    start_states: int | None = None,
    own_words: bool = False,
    **more: Any,
) -> Simulator:
    """Return a simulator with the tasks of a benchmark, for an entry point of the group `robogauntlet.simulators`.

    Args:
        name: Name of the simulator, and of the entry point.
        title: Its name for people.
        benchmark: See `Benchmark.path`.
        tasks: The class's name of a task to the goal in words, "" if the class says it.
        action: See `Benchmark`.
        cameras: See `Benchmark`.
        horizon: Control steps in which a competent policy succeeds comfortably.
        control_hz: See `Benchmark`.
        state: See `Benchmark`.
        arguments: See `Benchmark`.
        start_states: Number of the class's episodes of a task, if they are numbered and not drawn.
        own_words: See `Benchmark`.
        more: Further fields of the `Simulator`, such as `requirements` of an environment of its own.

    Raises:
        ValueError: Something is not as expected; or two tasks have one name here.
    """
    opened = Benchmark(benchmark, action, cameras, control_hz, state or {}, arguments or {}, own_words)
    body, theirs = opened.action_spec.body, {short(task): task for task in tasks}
    if len(theirs) < len(tasks):
        raise ValueError("tasks: expected names that differ in letters or digits, got two alike")

    def open_task(task: str, view: View) -> Simulation:
        from robogauntlet.adapters.vla_eval.simulation import BenchmarkSimulation

        return BenchmarkSimulation(opened, theirs[task], tasks[theirs[task]], view)

    shown = tuple(camera for camera in CAMERAS if camera in cameras)
    described = {
        task: TaskDescription(
            tasks[own] or own,
            horizon,
            cameras=shown,
            native=body.native,
            state=body.state,
            start_states=start_states,
            own_words=own_words,
        )
        for task, own in theirs.items()
    }
    modules = ("vla_eval", *more.pop("modules", ()))
    distributions = ("vla-eval", *more.pop("distributions", ()))
    return Simulator(name, title, described, modules, distributions, open_task, **more)


def short(task: str) -> str:
    """Return the name here of a task of the class, without spaces."""
    return re.sub(r"[^\w.-]+", "-", task, flags=re.ASCII).strip("-")
