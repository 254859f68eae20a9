"""The Ray actor around an `EpisodeRunner`: one simulator process."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Iterator, Mapping
from typing import Any

import psutil
import ray

from robogauntlet.adapters.contract import AdapterError
from robogauntlet.orchestrator.episodes.episode_runner import EpisodeRunner, Job
from robogauntlet.orchestrator.episodes.lease import Lease, Readiness
from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.orchestrator.inference.ray_policy_server import served_policies
from robogauntlet.orchestrator.scheduling.worker_pool import Unavailable
from robogauntlet.suites.episode import View
from robogauntlet.support.errors import describe
from robogauntlet.support.garbage_collection import collector_paused


@ray.remote
class Worker:
    """Plays leases one after the other and streams their results."""

    def __init__(self, name: str, sources: Mapping[str, PolicySource], job: Job, server: Any = None) -> None:
        # Ctrl-C in a terminal reaches the whole process group. The driver decides what it means.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        self._served = served_policies(server, sources) if server else {}
        self._runner = EpisodeRunner(sources, name, self._served, own_process=True)
        self._loaded: set[str] = set()
        self._job = job
        self._process = psutil.Process()

    def identify(self) -> tuple[int, str]:
        """Process id, and the id of the node."""
        return os.getpid(), ray.get_runtime_context().get_node_id()

    def prepare(self, task: str, view: View) -> Readiness | Unavailable:
        """Open a task."""
        try:
            with collector_paused():
                return self._runner.prepare(task, view)
        except AdapterError as error:
            return Unavailable(str(error))
        except Exception as error:  # a missing driver can raise anything
            return Unavailable(describe(error))

    @ray.method(num_returns="streaming")
    def play(self, lease: Lease) -> Iterator[tuple[list[Any], int, bool]]:
        """Play a lease and yield its results in order, short episodes in batches.

        Yields:
            Results, the memory of this process (bytes), and whether the lease is complete. First no results, once a
            policy is loaded that was not before: that may take minutes, which are not those of an episode.
        """
        if (name := lease.cell.policy) not in self._loaded:
            self._loaded.add(name)
            with contextlib.suppress(Exception), collector_paused():  # the episodes say what is wrong
                self._served[name].load() if name in self._served else self._runner.load(name)
            yield [], self._process.memory_info().rss, False
        batch: list[Any] = []
        sent = time.perf_counter()
        for left, result in zip(reversed(range(len(lease.seeds))), self._job(self._runner, lease), strict=True):
            batch.append(result)
            if not left or time.perf_counter() - sent >= lease.message_s:
                yield batch, self._process.memory_info().rss, not left
                batch, sent = [], time.perf_counter()
