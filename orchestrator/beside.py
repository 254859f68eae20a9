"""Runs a generator once for each of several simulators, each in a process of its own, on the Ray that is running."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import ray
from ray.exceptions import RayError

from adapters import catalog
from adapters.contract import Simulator, SimulatorUnavailable
from orchestrator.cluster import check_alive, ray_session
from orchestrator.environments.homes import Homes

CHECK_S = 1.0
"""Between looks at whether Ray is alive."""


@dataclass(frozen=True)
class Ended:
    """A simulator's process has ended before its generator did."""

    reason: str


def beside(
    generator: Callable[..., Iterator[Any]], arguments: Mapping[str, tuple[Any, ...]], homes: Homes | None = None
) -> Iterator[tuple[str, Any | Ended]]:
    """What the generators yield, as it comes.

    Args:
        generator: Importable on every node.
        arguments: Simulator to the arguments that the generator is called with.
        homes: In which environment each simulator runs.

    Yields:
        The simulator, and what its generator yielded or, as its last, why it was cut short.

    Raises:
        RayLost: Ray itself has died.
    """
    actor: Any = _Process
    homes = homes or Homes()
    streams: dict[Any, str] = {}
    actors = []  # they live as long as there are handles
    for simulator, own in arguments.items():
        environment = homes.for_ray(catalog.find(simulator))
        actors.append(actor.options(num_cpus=1, runtime_env=environment).remote())
        streams[actors[-1].run.remote(generator, own)] = simulator
    yield from _as_it_comes(streams)


def alone(
    generator: Callable[..., Iterator[Any]], simulator: Simulator, own: tuple[Any, ...], homes: Homes
) -> list[Any]:
    """What a generator yields in a process in the simulator's environment, on a Ray that is started if none runs.

    Raises:
        SimulatorUnavailable: The environment does not fit, or the process ended.
        RayLost: Ray itself has died.
    """
    if reason := homes.missing_reason(simulator):
        raise SimulatorUnavailable(f"{simulator.name}: {reason}")
    with ray_session(address=None, workers=1):
        came = [found for _, found in beside(generator, {simulator.name: own}, homes)]
    if came and isinstance(came[-1], Ended):
        raise SimulatorUnavailable(f"{simulator.name}: {came[-1].reason}")
    return came


@ray.remote(max_restarts=0, max_task_retries=0)
class _Process:
    """An actor, since of a task's stream Ray's own death makes `ray.wait` end this process, without a word."""

    def __init__(self) -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the driver decides

    @ray.method(num_returns="streaming")
    def run(self, generator: Callable[..., Iterator[Any]], arguments: tuple[Any, ...]) -> Iterator[Any]:
        yield from generator(*arguments)


def _as_it_comes(streams: dict[Any, str]) -> Iterator[tuple[str, Any | Ended]]:
    checked = time.monotonic()
    while streams:
        ready, _ = ray.wait(list(streams), num_returns=1, timeout=CHECK_S, fetch_local=False)
        if time.monotonic() - checked >= CHECK_S:  # workers may live on, and answer, for some time after Ray has died
            check_alive()
            checked = time.monotonic()
        if not ready:
            continue
        stream: Any = ready[0]
        try:
            yield streams[stream], ray.get(next(stream))
        except StopIteration:
            del streams[stream]
        except RayError as error:
            check_alive()
            lines = str(error).strip().splitlines() or ["the process ended"]
            yield streams.pop(stream), Ended(lines[-1])
