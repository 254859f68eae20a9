"""The names that suites may use. The orchestrator collects them, so that suites import no catalogs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace


@dataclass(frozen=True)
class KnownTask:
    """A task of an adapter."""

    horizon: int
    internal: bool = False
    """Whether it is for tests only, and not suggested to users."""
    robot: str = ""
    """Its robot, if it is a task for several."""


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
