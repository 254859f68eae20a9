"""Each perturbation of the world is delivered as asked for, changes nothing else, and is undone by the next reset."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from adapters.adjusting import ADJUSTABLE
from adapters.contract import AdapterError, UnsupportedCondition
from orchestrator.conformance.findings import Check, Fault, NotApplicable, check
from orchestrator.conformance.subject import Subject
from orchestrator.perturbations import perturbed
from orchestrator.perturbations.base import Perturbed
from orchestrator.plan import why_unadjusted
from suites.axes import AXES, Axis
from suites.vocabulary import Condition, Episode, Protocol

SEED = 7
WORLDLY = tuple(axis for axis in AXES.values() if str(axis.changes) in ADJUSTABLE)
"""Axes that reach into the world. The others are brought about between policy and simulation, see decision 5."""


def _played(axis: Axis) -> Check:
    @check(f"axis-{axis.name}", look=f"`adjusters.{axis.changes}`, which orchestrator/perturbations builds upon")
    def played(subject: Subject) -> Iterator[Fault]:
        """What the axis asks for is delivered at the mildest and at the strongest severity, and then undone."""
        if reason := why_unadjusted(axis, subject.task):
            raise NotApplicable(reason)
        simulation = subject.reset(SEED)
        start, own = simulation.state_hash(), dict(simulation.observe().images)
        for severity in (1, len(axis.levels)):
            condition = Condition(axis.name, severity)
            protocol = Protocol(subject.card.horizon, 8, subject.view)
            scene = perturbed(simulation, Episode("check", "check", subject.task, SEED, protocol, condition))
            assert isinstance(scene, Perturbed)
            try:
                scene.reset(SEED, condition)
                scene.check_start()
                scene.observe()
                found = scene.delivered()
            except UnsupportedCondition as error:
                raise NotApplicable(str(error)) from None
            except AdapterError as error:
                yield Fault(f"{axis.value(severity):g} {axis.unit}", str(error))
                continue
            wanted = axis.value(severity)
            if found is None or found.value is None or abs(found.value - wanted) > axis.tolerance:
                yield Fault(f"{wanted:g} {axis.unit} within {axis.tolerance:g}", str(found and found.value))
            subject.reset(SEED)
            if simulation.state_hash() != start:
                yield Fault(f"the clean start after {condition}", "another state")
            after = simulation.observe().images
            if any((np.asarray(after[camera]) != own[camera]).any() for camera in own):
                yield Fault(f"the clean images after {condition}", "others")

    return played


CHECKS = tuple(_played(axis) for axis in WORLDLY)
