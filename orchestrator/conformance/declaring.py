"""What declaring a simulator costs every command, whether or not it plays there."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from importlib import metadata

from adapters.catalog import GROUP
from orchestrator.conformance.findings import Fault, check
from orchestrator.conformance.subject import Subject

HEAVY = ("torch", "mujoco", "sapien", "pybullet", "gymnasium", "jax", "tensorflow", "cv2")


def modules_loaded_by(simulator: str) -> frozenset[str]:
    """Modules that are imported by loading the simulator's entry point, of those that were not there before."""
    before = set(sys.modules)
    for entry in metadata.entry_points(group=GROUP, name=simulator):
        entry.load()
    return frozenset(set(sys.modules) - before)


@check("declaration", look="the imports at the top of the adapter: the simulator is imported by `open` only", once=True)
def declaration(subject: Subject) -> Iterator[Fault]:
    """Declaring the simulator imports neither it nor anything heavy."""
    unwanted = {*subject.simulator.modules, *HEAVY} & subject.loaded_by_declaring
    if unwanted:
        yield Fault("an entry point that imports no simulator", f"it imports {', '.join(sorted(unwanted))}")


CHECKS = (declaration,)
