"""The names that suites may use: gathered by whoever knows the catalogs, so that suites import nothing of ours."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace


@dataclass(frozen=True)
class KnownTask:
    """A task that some adapter offers."""

    horizon: int
    internal: bool = False
    """Whether it is there for tests, so that nobody is told of it."""


@dataclass(frozen=True)
class KnownPolicy:
    """A kind of policy that is installed."""

    options: frozenset[str] = frozenset()
    tasks: frozenset[str] | None = None
    """Tasks it can act in, or None for all."""
    has_environment: bool = False
    """Whether it may have a Python environment of its own."""


@dataclass(frozen=True)
class Registry:
    """The names that a suite may use."""

    tasks: Mapping[str, KnownTask]
    """`simulator/task` to what is known of it."""
    policies: Mapping[str, KnownPolicy]
    axes: Mapping[str, int] = field(default_factory=dict)
    """Perturbation axis to its highest severity."""

    @property
    def simulators(self) -> list[str]:
        """Names of the simulators, sorted."""
        return sorted({task.partition("/")[0] for task in self.tasks})

    @property
    def public(self) -> Registry:
        """Those to tell of."""
        return replace(self, tasks={name: task for name, task in self.tasks.items() if not task.internal})
