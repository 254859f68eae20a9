"""Checks whether simulators work on this machine, each in a child process, because a driver may crash."""

from __future__ import annotations

import os
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.suites.episode import CAMERAS, View
from robogauntlet.support.child_process import ChildEnded, ChildTimeout, JsonChild, serve
from robogauntlet.support.errors import describe

TIME_LIMIT_S = 240.0


@dataclass(frozen=True)
class Finding:
    """Whether one simulator works."""

    simulator: str
    versions: dict[str, str]
    problem: str | None
    """Why it does not work, with the remedy, or None."""
    installed: bool = True
    """Whether it is installed, or an environment is configured for it."""
    render_device: str = ""
    frame_ms: float | None = None
    """Time of one warm observation by one camera (ms)."""


def probe(simulators: Iterable[str], environments: EnvironmentResolver | None = None) -> list[Finding]:
    """Check simulators by name, two at a time."""
    environments = environments or EnvironmentResolver()
    with ThreadPoolExecutor(max_workers=2) as pool:
        return list(pool.map(lambda name: _probe_one(name, environments), simulators))


def _probe_one(name: str, environments: EnvironmentResolver) -> Finding:
    simulator = catalog.find(name)
    versions = environments.versions(simulator)
    if missing := environments.missing_reason(simulator):
        own = environments.resolve(simulator)
        wanted = own is not None and not (own.origin == "its adapter" and own.manifest is None)
        return Finding(name, versions, missing, installed=wanted)
    python, environment = environments.subprocess_env(simulator)
    command = [python, "-m", "robogauntlet.orchestrator.environments.probe"]
    try:
        with JsonChild(command, environment=environment) as child:
            return Finding(name, versions, **child.ask(name, TIME_LIMIT_S))
    except ChildTimeout:
        return Finding(name, versions, f"did not open within {TIME_LIMIT_S:g} s")
    except ChildEnded as error:
        return Finding(name, versions, str(error))


def _open_and_observe(name: str) -> dict[str, object]:
    # Only the child plays; the command that asks starts without what a simulator needs.
    from robogauntlet.orchestrator.episodes.episode_runner import EpisodeRunner

    simulator = catalog.find(name)
    runner = EpisodeRunner({})
    try:
        task = catalog.installed_task(simulator) or next(iter(simulator.tasks))
        readiness = runner.prepare(f"{name}/{task}", View(CAMERAS[:1]))
    except Exception as error:  # a missing driver can raise anything
        return {"problem": describe(error)}
    finally:
        runner.close()
    frame_ms = readiness.frame_s and round(1000 * readiness.frame_s, 1)
    return {"problem": None, "render_device": readiness.render_device, "frame_ms": frame_ms}


if __name__ == "__main__":
    serve(_open_and_observe)
    os._exit(0)
