"""The names that suites may use, gathered from the catalogs."""

from __future__ import annotations

from adapters import catalog as simulators
from policies import catalog as policies
from suites.axes import AXES
from suites.known import KnownNames, KnownPolicy, KnownTask


def known_names() -> KnownNames:
    """Every task and policy that some entry point declares, installed or not."""
    return KnownNames(
        tasks={
            f"{simulator.name}/{task}": KnownTask(card.horizon, simulator.internal)
            for simulator in simulators.simulators().values()
            for task, card in simulator.tasks.items()
        },
        policies={
            kind.name: KnownPolicy(
                frozenset(kind.options),
                kind.tasks() if kind.tasks else None,
                bool(kind.requirements or kind.without_dependencies),
            )
            for kind in policies.kinds().values()
        },
        axes={axis.name: len(axis.levels) for axis in AXES.values()},
    )
