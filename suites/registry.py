"""The names that suites may use. The orchestrator collects them, so that suites import no catalogs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from robogauntlet.suites.episode import FIRST_TRAINING_SEED


@dataclass(frozen=True)
class KnownTask:
    """A task of an adapter."""

    horizon: int
    internal: bool = False
    """Whether it is for tests only, and not suggested to users."""
    robot: str = ""
    """Its robot, if it is a task for several."""
    start_states: int | None = None
    """Stored states in which it can start, if seeds choose among them."""

    def why_repeated(self, seeds: range) -> str | None:
        """Return why some of the seeds would start like others and be counted as new, None if none would.

        Seeds for training have no stored states.
        """
        states = self.start_states
        if states is None or seeds[-1] < states or seeds[0] >= FIRST_TRAINING_SEED:
            return None
        there = (
            "seed 0 alone, since it has one stored state"
            if states == 1
            else (f"seeds 0 to {states - 1}, since it has {states} stored states")
        )
        return f"expected {there}, which further seeds repeat; got seeds {seeds[0]} to {seeds[-1]}"


def stored_states(tasks: Iterable[str], known: Mapping[str, KnownTask]) -> list[int]:
    """Return the numbers of stored states of those of the tasks that start in some. Unknown tasks are passed over."""
    found = (known[task].start_states for task in tasks if task in known)
    return [states for states in found if states is not None]


@dataclass(frozen=True)
class KnownPolicy:
    """A kind of policy that is installed."""

    options: frozenset[str] = frozenset()
    tasks: frozenset[str] | None = None
    """Tasks in which it can act, or None for all."""
    has_environment: bool = False
    """Whether it can have its own Python environment."""
    no_skill: bool = False
    """Whether it shows what chance achieves."""


@dataclass(frozen=True)
class Registry:
    """The names that a suite may use."""

    tasks: Mapping[str, KnownTask]
    """By `simulator/task`."""
    policies: Mapping[str, KnownPolicy]
    separate: Mapping[str, str] = field(default_factory=dict)
    """Kinds of policies that are not installed, to what installs them."""
    axes: Mapping[str, int] = field(default_factory=dict)
    """Perturbation axis to its highest severity."""

    @property
    def simulators(self) -> list[str]:
        """Names of the simulators, sorted."""
        return sorted({task.partition("/")[0] for task in self.tasks})

    @property
    def public(self) -> Registry:
        """The registry without internal tasks."""
        return replace(self, tasks={name: task for name, task in self.tasks.items() if not task.internal})
