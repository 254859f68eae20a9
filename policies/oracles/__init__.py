"""Scripted oracles: policies that act on the true state and show that a task can be solved."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib import import_module
from typing import Any

from robogauntlet.policies.contract import Decision, Policy, PolicyError, PolicyInput, PolicyKind, PolicySpec, Query
from robogauntlet.policies.digests import scripted_digest, source_digest
from robogauntlet.policies.oracles import motion
from robogauntlet.policies.oracles.motion import Script
from robogauntlet.policies.oracles.plugins import OraclePlugin, load_oracles
from robogauntlet.suites.episode import Episode
from robogauntlet.suites.plugins import BrokenPlugin

_SCRIPT_MODULES: Mapping[str, tuple[str, ...]] = {
    "null": (),
    "maniskill": ("maniskill_motion",),
    "pybullet": (),
    "robosuite": ("joints",),
    "metaworld": (),
    "gymnasium": (),
    "libero": (),
    "two_arms": ("maniskill_motion", "robosuite", "joints"),
    "transport": ("two_arms", "maniskill_motion", "robosuite", "joints"),
    "tool_hang": ("robosuite", "joints"),
    "so101": (),
    "aloha": ("joints", "two_arms", "maniskill_motion", "robosuite"),
}
"""Modules of scripts to the modules beside them, except `motion`, from which they import."""


@cache
def scripts() -> Mapping[str, Callable[[], Script]]:
    """Return the script of each task (`simulator/task`), including plug-ins. Light: no simulator is imported."""
    return {task: script for source in _sources() for task, script in source.scripts.items()}


def _sources() -> list[OraclePlugin]:
    """Return plug-ins first, then the built-in scripts, which plug-ins cannot replace."""
    plugins = [plugin for name, plugin in load_oracles()[0].items() if name not in _SCRIPT_MODULES]
    for name, shared in _SCRIPT_MODULES.items():
        module = import_module(f"{__name__}.{name}")
        beside = tuple(f"{__name__}.{other}" for other in shared)
        plugins.append(OraclePlugin(name, module.SCRIPTS, module.__name__, beside))
    return plugins


def broken_plugins() -> tuple[BrokenPlugin, ...]:
    """Return the entry points that declare no usable scripts."""
    plugins, broken = load_oracles()
    built_in = sorted(plugins.keys() & _SCRIPT_MODULES.keys())
    return *broken, *(BrokenPlugin(name, f"'{name}' has built-in oracles, which stay in use") for name in built_in)


class OraclePolicy:
    """Acts by the script of the episode's task, which is called before every control step."""

    spec = PolicySpec(PolicyInput.PRIVILEGED_STATE, chunk_length=1, action_dim=None)

    def __init__(self) -> None:
        self._playing: dict[str, Script] = {}

    def reset(self, episodes: Sequence[Episode]) -> None:
        """Start a script for each episode. Raises PolicyError if a task has none."""
        for episode in episodes:
            if episode.task not in scripts():
                raise PolicyError(f"the oracle has no script for '{episode.task}'")
            self._playing[episode.id] = scripts()[episode.task]()

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """Return a chunk of one action for each query."""
        decisions = []
        for query in queries:
            assert query.privileged_state is not None
            decisions.append(Decision(self._playing[query.episode.id](query.privileged_state)[None]))
        return decisions

    def finish(self, episodes: Sequence[Episode]) -> None:
        """Drop the episodes' scripts."""
        for episode in episodes:
            self._playing.pop(episode.id, None)


def _load(options: Mapping[str, Any]) -> Policy:
    return OraclePolicy()


def _digest(options: Mapping[str, Any]) -> str:
    modules = [module for source in _sources() for module in source.modules()]
    return scripted_digest("oracle", sys.modules[__name__], motion, *dict.fromkeys(modules))(options)


def digest_of_task(task: str) -> str:
    """Return the hash of the scripts of one task's (`simulator/task`) simulator; the policy's digest covers all.

    Raises PolicyError if the task has no script.
    """
    for source in _sources():
        if task in source.scripts:
            return source_digest(motion, *source.modules())
    raise PolicyError(f"the oracle has no script for '{task}'")


ORACLE = PolicyKind(
    name="oracle",
    summary="a script per task that reads the true state",
    load=_load,
    digest=_digest,
    tasks=lambda: frozenset(scripts()),
)
