"""The Ray actor around an `EpisodeRunner`: one simulator process."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import psutil
import ray

from adapters.contract import AdapterError
from orchestrator.runner import EpisodeRunner, Lease, Readiness
from orchestrator.serving import served_policies
from orchestrator.sources import PolicySource
from results.record import EpisodeResult
from suites.placement import Resources
from suites.vocabulary import View


@ray.remote
class Worker:
    """Plays leases. Leases run one after the other; their results stream back while they run."""

    def __init__(
        self, name: str, sources: Mapping[str, PolicySource], resources: Resources, server: Any = None
    ) -> None:
        # Ctrl-C in a terminal reaches the whole process group. The driver decides what it means.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        elsewhere = served_policies(server, sources) if server else None
        self._runner = EpisodeRunner(sources, name, elsewhere, resources)
        self._idle_since: float | None = None
        self._process = psutil.Process()

    def hello(self) -> tuple[int, str]:
        """Process id and node: the first word of a worker that has been given a place."""
        return os.getpid(), os.uname().nodename

    def prepare(self, task: str, view: View) -> Readiness | str:
        """Open a task; return what was found, or why the simulator is unavailable here."""
        try:
            return self._runner.prepare(task, view)
        except AdapterError as error:
            return str(error)
        except Exception as error:  # a driver that is missing shows as any exception
            lines = str(error).strip().splitlines()
            return f"{type(error).__name__}: {lines[0] if lines else '(no message)'}"

    @ray.method(num_returns="streaming")
    def play(self, lease: Lease) -> Iterator[tuple[list[EpisodeResult], int, bool]]:
        """Play a lease; yield its results in order, those of short episodes together.

        With them come the memory that is held (bytes), and whether they are the last.
        """
        waited = 0.0 if self._idle_since is None else time.perf_counter() - self._idle_since
        batch: list[EpisodeResult] = []
        sent = time.perf_counter()
        for left, result in zip(reversed(range(len(lease.seeds))), self._runner.play(lease), strict=True):
            if waited:
                result, waited = replace(result, wait_s=waited), 0.0
            batch.append(result)
            if not left:
                self._idle_since = time.perf_counter()
            if not left or time.perf_counter() - sent >= lease.message_s:
                yield batch, self._process.memory_info().rss, not left
                batch, sent = [], time.perf_counter()


def start_worker(
    name: str,
    environment: Mapping[str, Any],
    sources: Mapping[str, PolicySource],
    resources: Resources,
    server: Any = None,
) -> Any:
    """Start an actor; returns its handle at once, while it is still starting.

    Args:
        name: Of the worker.
        environment: Ray's `runtime_env` for the simulator whose tasks it opens (`Homes.for_ray`).
        sources: Policy name to what it is built from.
        resources: What it needs.
        server: Answers for the policies that look at images (`orchestrator.serving`), or None.
    """
    actor: Any = Worker
    asked = resources.for_ray()
    actor = actor.options(max_restarts=0, max_task_retries=0, runtime_env=dict(environment), **asked)
    return actor.remote(name, dict(sources), resources, server)
