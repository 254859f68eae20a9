"""Each perturbation of the world is delivered as asked for, changes nothing else, and is undone by the next reset."""

from __future__ import annotations

from collections.abc import Iterator

from adapters.adjusting import ADJUSTABLE
from adapters.contract import AdapterError, Simulation, UnsupportedCondition
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
    @check(
        f"axis-{axis.name}", look=f"`adjusters.{axis.changes}`, which orchestrator/perturbations builds upon", once=True
    )
    def played(subject: Subject) -> Iterator[Fault]:
        """What the axis asks for is delivered at the mildest and at the strongest severity, and then undone."""
        if reason := why_unadjusted(axis, subject.task):
            raise NotApplicable(reason)
        start = subject.start(SEED)
        for severity in (1, len(axis.levels)):
            condition, wanted = Condition(axis.name, severity), axis.value(severity)
            protocol = Protocol(subject.card.horizon, 8, subject.view)
            episode = Episode("check", "check", subject.task, SEED, protocol, condition)
            try:
                found = _delivered(perturbed(subject.simulation, episode, subject.references), condition)
            except UnsupportedCondition as error:
                raise NotApplicable(str(error)) from None
            except AdapterError as error:
                yield Fault(f"{wanted:g} {axis.unit}", str(error))
                continue
            if found is None or abs(found - wanted) > axis.tolerance:
                yield Fault(f"{wanted:g} {axis.unit} within {axis.tolerance:g}", str(found))
            subject.reset(SEED)
            for difference in subject.differences(start, picture=False):
                yield Fault(f"the clean episode after {condition}", difference)

    return played


def _delivered(scene: Simulation, condition: Condition) -> float | None:
    """What a perturbed episode delivers, in the unit of its axis, as the first look shows.

    Raises:
        AdapterError: It is not what was asked for.
    """
    assert isinstance(scene, Perturbed)
    scene.reset(SEED, condition)
    scene.check_start()
    scene.observe()
    found = scene.delivered()
    return None if found is None else found.value


CHECKS = tuple(_played(axis) for axis in WORLDLY)
