"""Each perturbation of the scene is delivered as requested, changes nothing else, and is undone by the next reset."""

from __future__ import annotations

from collections.abc import Iterator

from robogauntlet.adapters.contract import AdapterError, UnsupportedCondition
from robogauntlet.adapters.scene_control import ADJUSTABLE
from robogauntlet.orchestrator.kit.adapter.check import Check, NotApplicable, Violation, check, expect, expect_restored
from robogauntlet.orchestrator.kit.adapter.checked_task import CheckedTask
from robogauntlet.orchestrator.perturbations import perturbed
from robogauntlet.orchestrator.perturbations.base import Perturbed
from robogauntlet.orchestrator.registry import why_unadjusted
from robogauntlet.suites.axes import AXES
from robogauntlet.suites.axis import Axis
from robogauntlet.suites.episode import Condition, Episode, Protocol

SEED = 7
SCENE_AXES = tuple(axis for axis in AXES.values() if str(axis.changes) in ADJUSTABLE)
"""Axes that need scene controls. The others act between policy and simulation, see decision 5."""


def _axis_check(axis: Axis) -> Check:
    look = f"`scene_controls.{axis.changes}`, which orchestrator/perturbations uses"

    @check(f"axis-{axis.name}", look=look, once=True)
    def delivered(subject: CheckedTask) -> Iterator[Violation]:
        """The axis delivers its level at the mildest and at the strongest severity, and a reset undoes it."""
        if reason := why_unadjusted(axis, subject.task):
            raise NotApplicable(reason)
        start = subject.start(SEED)
        protocol = Protocol(subject.description.horizon, 8, subject.view)
        for severity in (1, len(axis.levels)):
            condition, level = Condition(axis.name, severity), axis.value(severity)
            episode = Episode("check", "check", subject.task, SEED, protocol, condition)
            try:
                simulation = perturbed(subject.simulation, episode, subject.references)
                assert isinstance(simulation, Perturbed)
                simulation.reset(SEED)
                simulation.check_start()
                simulation.observe()
                value = simulation.delivered().value
            except UnsupportedCondition as error:
                raise NotApplicable(str(error)) from None
            except AdapterError as error:
                yield Violation(f"{level:g} {axis.unit}", str(error))
                continue
            near = value is not None and abs(value - level) <= axis.tolerance
            yield from expect(near, f"{level:g} {axis.unit} within {axis.tolerance:g}", value)
            yield from expect_restored(subject, start, f"the clean episode after {condition}", picture=False)

    return delivered


CHECKS = tuple(_axis_check(axis) for axis in SCENE_AXES)
