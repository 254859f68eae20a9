"""The work of a worker, without Ray: keeps a simulation open and policies loaded, and plays leases."""

from __future__ import annotations

import os
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

from robogauntlet.adapters import catalog as simulators
from robogauntlet.adapters.contract import AdapterError, Simulation, SimulatorUnavailable, TaskUnavailable
from robogauntlet.orchestrator.episodes.lease import Lease, Readiness
from robogauntlet.orchestrator.episodes.policy_source import PolicySource, build_policy
from robogauntlet.orchestrator.episodes.rollout import Watcher, rollout
from robogauntlet.orchestrator.perturbations.base import ReferenceImages
from robogauntlet.policies.contract import Policy, PolicyError, check_fit
from robogauntlet.results.record import LEFT_OUT, EpisodeResult
from robogauntlet.suites.episode import CAMERAS, Episode, View
from robogauntlet.support.errors import describe

UNKNOWN_DEVICE = "an unknown device, as its first task is left out"


class EpisodeRunner:
    """Plays episodes in this process."""

    def __init__(
        self,
        sources: Mapping[str, PolicySource],
        worker: str = "local",
        remote_policies: Mapping[str, Policy] | None = None,
        *,
        own_process: bool = False,
    ) -> None:
        """Create a runner. A policy is built from its source when it is first needed, unless it computes remotely.

        With `own_process` nobody interrupts this process from a keyboard, so that what would end it is a policy's.
        """
        self._own_process = own_process
        self._sources = sources
        self._worker = worker
        self._policies: dict[str, Policy] = dict(remote_policies or {})
        self._simulation: Simulation | None = None
        self._opened: tuple[str, View] | None = None
        self._references = ReferenceImages()
        self._build_s = self._load_s = 0.0
        self._idle_since: float | None = None

    def prepare(self, task: str, view: View) -> Readiness:
        """Open a task and render a frame, to check that the simulator works here.

        If the task cannot be opened, another one of the simulator shows it: the episodes of the first then say what is
        wrong with theirs, whichever task comes first.

        Raises:
            AdapterError: The simulator does not work; the message says why.
            Exception: Whatever the simulator raises.
        """
        name, _, short = task.partition("/")
        simulator, frame_s = simulators.find(name), None
        try:
            simulation = self.simulation(task, view)
        except SimulatorUnavailable:
            raise
        except Exception as problem:  # simulators raise anything
            other = next((other for other in simulator.tasks if other != short), short)
            cameras = tuple(camera for camera in view.cameras if camera in simulator.tasks[other].cameras)
            try:
                simulation = self.simulation(f"{name}/{other}", replace(view, cameras=cameras or CAMERAS[:1]))
            except TaskUnavailable:
                if isinstance(problem, TaskUnavailable):
                    return Readiness(os.getpid(), UNKNOWN_DEVICE, None)
                raise problem from None
            except SimulatorUnavailable:
                raise
            except Exception:
                raise problem from None
        if simulator.renders:
            simulation.reset(0)  # the contract does not define a simulation before its first reset
            simulation.observe()
            start = time.perf_counter()
            simulation.observe()
            frame_s = time.perf_counter() - start
        return Readiness(os.getpid(), simulation.render_device(), frame_s)

    def play(self, lease: Lease, play_one: Callable[[Episode], EpisodeResult] | None = None) -> Iterator[EpisodeResult]:
        """Play the lease's episodes. An episode that cannot be played yields an error record; no error is raised.

        Args:
            lease: The episodes.
            play_one: Plays one of them instead of the method of this name.
        """
        wait_s = 0.0 if self._idle_since is None else time.perf_counter() - self._idle_since
        for result in map(play_one or self.play_one, lease.episodes()):
            self._idle_since = time.perf_counter()
            yield replace(
                result,
                worker=self._worker,
                attempts=lease.attempt + result.attempts - 1,
                wait_s=wait_s,
                build_s=self._build_s,
                load_s=self._load_s,
            )
            wait_s = self._build_s = self._load_s = 0.0

    def play_one(
        self, episode: Episode, watcher: Watcher | None = None, wrap: Callable[[Simulation], Simulation] | None = None
    ) -> EpisodeResult:
        """Play one episode in the simulation, or in what `wrap` returns for it; for `watcher` see `rollout`.

        After an unexpected exception it is tried once more in a new simulation, which counts as an attempt. The result
        is an error record if the episode could not be played.
        """
        started, clock = time.time(), time.perf_counter()
        error = ""
        for attempt in (1, 2):
            try:
                policy = self._policy(episode.policy)
                simulation = self.simulation(episode.task, episode.protocol.view)
                check_fit(policy.spec, simulation.action_spec, simulation.observation_spec)
                result = rollout(
                    wrap(simulation) if wrap else simulation,
                    policy,
                    episode,
                    watcher=watcher,
                    references=self._references,
                )
                return replace(result, attempts=attempt)
            except (AdapterError, PolicyError) as known:
                kind = LEFT_OUT if isinstance(known, TaskUnavailable) else type(known).__name__
                error = f"{kind}: {known}"
                self._drop(episode)
                break
            except Exception as unknown:  # simulators and policies raise anything; one episode must not end the rest
                error = _describe(unknown)
                self._drop(episode)
                self.close()
            except (SystemExit, KeyboardInterrupt) as left:
                if not self._own_process or getattr(left, "is_ray_terminate", False):  # Ray ends its workers so
                    raise
                error = _describe(left)
                self._drop(episode)
                self.close()
                break
        return EpisodeResult.failed_to_run(
            episode, error, attempts=attempt, started_at=started, wall_s=time.perf_counter() - clock
        )

    def load(self, policy: str) -> None:
        """Load a policy, by its name. Raises whatever that raises; episodes that need it would report it."""
        start = time.perf_counter()
        self._policy(policy)
        if self._idle_since is not None:
            self._idle_since += time.perf_counter() - start

    def close(self) -> None:
        """Close the open simulation. The runner can go on afterwards."""
        simulation, self._simulation, self._opened = self._simulation, None, None
        if simulation is not None:
            simulation.close()

    def simulation(self, task: str, view: View) -> Simulation:
        """The task's simulation, which stays open until another one is requested.

        Raises:
            AdapterError: The task cannot be opened.
        """
        if self._simulation is None or self._opened != (task, view):
            self.close()
            start = time.perf_counter()
            for name, value in simulators.find(task.partition("/")[0]).environment.items():
                os.environ.setdefault(name, value)
            self._simulation = simulators.open_simulation(task, view)
            self._opened, self._references = (task, view), ReferenceImages()
            self._build_s += time.perf_counter() - start
        return self._simulation

    def _policy(self, name: str) -> Policy:
        if name not in self._policies:
            start = time.perf_counter()
            self._policies[name] = build_policy(self._sources[name])
            self._load_s += time.perf_counter() - start
        return self._policies[name]

    def _drop(self, episode: Episode) -> None:
        """Let the policy drop its state of an episode that ended with an error."""
        with suppress(Exception):  # the policy may be what raised
            if episode.policy in self._policies:
                self._policies[episode.policy].finish([episode])


Job = Callable[[EpisodeRunner, Lease], Iterator[Any]]
"""Plays a lease and yields a result for each episode, in order. Pickled and sent to each worker.

It raises AdapterError or PolicyError if the lease's task cannot be played at all."""


def _describe(error: BaseException) -> str:
    """Type, message and innermost location of an exception, without anything that differs between runs."""
    frame = traceback.extract_tb(error.__traceback__)[-1]
    place = f"{os.path.basename(frame.filename)}:{frame.lineno}"  # noqa: PTH119
    return f"{describe(error)} [{place}]"
