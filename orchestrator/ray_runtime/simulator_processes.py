"""Runs a generator in one process per simulator, on the Ray that is running."""

from __future__ import annotations

import contextlib
import math
import os
import signal
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import ray
from ray.exceptions import RayError

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import Simulator, SimulatorUnavailable
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver, worker_environment
from robogauntlet.orchestrator.ray_runtime.cluster import Placement, placed_on
from robogauntlet.orchestrator.ray_runtime.session import WORKER_BYTES, RayLost, check_alive, in_session, ray_session
from robogauntlet.support.errors import last_line

CHECK_S = 1.0
"""Time between checks that Ray is alive."""


@dataclass(frozen=True)
class ProcessEnded:
    """A simulator's process died before the end of its generator, or could not be started."""

    reason: str


def run_per_simulator(
    generator: Callable[..., Iterator[Any]],
    arguments: Mapping[str, tuple[Any, ...]],
    environments: EnvironmentResolver | None = None,
    *,
    silence_s: float = math.inf,
    time_s: float = math.inf,
) -> Iterator[tuple[str, Any | ProcessEnded]]:
    """Run a generator in one process per simulator, in parallel, as far as memory allows. They share the cores.

    Args:
        generator: Importable on every node.
        arguments: Simulator to the arguments of its generator.
        environments: The environment of each simulator.
        silence_s: Time without a result after which a process is killed, counted from its start (s).
        time_s: Time after which all processes are killed and no more results are yielded (s).

    Yields:
        The simulator and the next item of its generator, or as its last item `ProcessEnded`.

    Raises:
        RayLost: Ray itself has died.
    """
    began = checked = time.monotonic()
    environments = environments or EnvironmentResolver()
    streams: dict[Any, str] = {}
    actors: dict[str, Any] = {}
    process: Any = _Process
    room, placement = _room(len(arguments)), Placement(environments)
    try:
        for name, its_arguments in arguments.items():
            simulator = catalog.find(name)
            if reason := environments.missing_reason(simulator):
                yield name, ProcessEnded(reason)
                continue
            options = {**room, **placed_on(placement.nodes(simulator))}
            environment = in_session(environments.ray_runtime_env(simulator))
            actors[name] = process.options(runtime_env=environment, **options).remote()
            streams[actors[name].run.remote(generator, its_arguments)] = name
        last_heard: dict[Any, float] = {}
        while streams and (left_s := began + time_s - time.monotonic()) > 0:
            ready, _ = ray.wait(list(streams), num_returns=1, timeout=min(CHECK_S, left_s), fetch_local=False)
            if time.monotonic() - checked >= CHECK_S:  # workers may still answer for some time after Ray has died
                check_alive()
                checked = time.monotonic()
            if not ready:
                for silent, heard in last_heard.items():
                    if silent in streams and time.monotonic() - heard > silence_s:
                        name = streams.pop(silent)
                        ray.kill(actors.pop(name))
                        yield name, ProcessEnded(f"no result within {silence_s:g} s")
                continue
            stream: Any = ready[0]
            name, has_started = streams[stream], stream in last_heard
            last_heard[stream] = time.monotonic()
            try:
                item = ray.get(next(stream))
            except (StopIteration, RayError) as ended:
                del streams[stream]
                ray.kill(actors.pop(name))  # another process may wait for its room
                if isinstance(ended, RayError):
                    check_alive()
                    yield name, ProcessEnded(last_line(ended))
            else:
                if has_started:
                    yield name, item
    except RayLost:
        actors.clear()  # a dead Ray would not answer
        raise
    finally:
        for remaining in actors.values():
            with contextlib.suppress(RayError):  # after an interruption Ray may have been shut down
                ray.kill(remaining)


def _room(processes: int) -> dict[str, float]:
    """Options of each of these processes, so that together they fit the cores, and each fits the memory of a node."""
    cores = ray.cluster_resources().get("CPU", 1.0)
    memory = max(node["Resources"].get("memory", 0.0) for node in ray.nodes() if node["Alive"])
    share = math.floor(1000 * min(1.0, cores / max(processes, 1))) / 1000  # Ray rounds at the fourth decimal
    return {"num_cpus": share, "memory": min(WORKER_BYTES, memory)}


def run_in_simulator_environment(
    generator: Callable[..., Iterator[Any]],
    simulator: Simulator,
    arguments: tuple[Any, ...],
    environments: EnvironmentResolver,
) -> list[Any]:
    """Run a generator in this process or, if the simulator has its own environment, in a process there.

    Returns:
        The items of the generator.

    Raises:
        SimulatorUnavailable: The environment is unsuitable, or the process died.
        RayLost: Ray itself has died.
    """
    if environments.resolve(simulator) is None:
        for other in catalog.simulators().values():  # before any import: simulators import each other's renderers
            os.environ.update(worker_environment(other))
        return list(generator(*arguments))
    with ray_session(address=None, workers=1):
        results = [result for _, result in run_per_simulator(generator, {simulator.name: arguments}, environments)]
    if results and isinstance(results[-1], ProcessEnded):
        raise SimulatorUnavailable(f"{simulator.name}: {results[-1].reason}")
    return results


@ray.remote(max_restarts=0, max_task_retries=0)
class _Process:
    """An actor instead of a task, because with a task's stream `ray.wait` exits this process when Ray dies."""

    def __init__(self) -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the driver decides

    @ray.method(num_returns="streaming")
    def run(self, generator: Callable[..., Iterator[Any]], arguments: tuple[Any, ...]) -> Iterator[Any]:
        yield "started"
        yield from generator(*arguments)
