"""A task's goal, and what behaviour is measured from."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from robogauntlet.adapters.contract import FloatArray, Motion
from robogauntlet.adapters.goals import goal_distance, goal_mistakes
from robogauntlet.adapters.motion import MeasuresMotion
from robogauntlet.orchestrator.kit.adapter.check import NotApplicable, Violation, check, expect
from robogauntlet.orchestrator.kit.adapter.checked_task import CheckedTask

SEEDS = range(4)
SAME = 0.005
"""Largest difference between a motion and the privileged state (m, rad)."""


@check("goal", look="`goal` of the TaskDescription, and the entries of privileged_state")
def goal(subject: CheckedTask) -> Iterator[Violation]:
    """The goal is one of entries of the privileged state, and is not always reached at the start."""
    declared = subject.description.goal
    if declared is None:
        raise NotApplicable("the task declares no goal")
    distances = []
    for seed in SEEDS:
        state = subject.reset(seed).privileged_state()
        if mistakes := list(goal_mistakes(declared, state)):
            yield from (Violation(f"{field}: {expected}", seen) for field, expected, seen in mistakes)
            return
        distances.append(float(goal_distance(declared, state[declared.entry], state[declared.to or declared.entry])))
    expected = (
        f"the goal farther than its tolerance of {declared.tolerance:g} at the start of one of {len(SEEDS)} seeds"
    )
    yield from expect(max(distances) > declared.tolerance, expected, f"at most {max(distances):.3f}")


@check("motion", look="Simulation.motion")
def motion(subject: CheckedTask) -> Iterator[Violation]:
    """A motion agrees with the privileged state, and reading it changes nothing."""
    simulation, declared = subject.reset(1), subject.description.goal
    if not isinstance(simulation, MeasuresMotion):
        raise NotApplicable("the simulation has no `motion`: behaviour is measured by its privileged state")
    named = [declared.entry, declared.to, declared.handle] if declared else []
    entries = ["tcp_position", *filter(None, named)]
    for action in subject.random_actions(5, 6):
        simulation.step(action)
    before = simulation.state_hash()
    now = simulation.motion(entries)
    after, state = simulation.state_hash(), simulation.privileged_state()
    yield from expect(after == before, "the same state before and after reading a motion", f"{before}, then {after}")
    if not isinstance(now, Motion) or len(now.entries) != len(entries):
        yield Violation(f"a Motion with {len(entries)} entries", repr(now)[:200])
        return
    opening = np.array([state["finger_positions"].sum()])
    pairs = {"tool": (now.tool, state["tcp_position"]), "opening": (np.array([now.opening]), opening)}
    pairs |= {f"entry `{name}`": (value, state[name]) for name, value in zip(entries, now.entries, strict=True)}
    for name, (given, true) in pairs.items():
        same = np.shape(given) == np.shape(true) and np.allclose(given, true, atol=SAME, rtol=0.0)
        yield from expect(same, f"{name}: {_numbers(true)}, as in privileged_state", _numbers(given))
    pushed, margin = now.contact_force, now.joint_margin
    known = pushed is None or (np.isfinite(pushed) and pushed >= 0.0)
    yield from expect(known, "a contact force of 0 N or more, or None", pushed)
    yield from expect(margin is None or np.isfinite(margin), "a joint margin that is finite, or None", margin)


def _numbers(values: FloatArray) -> str:
    return f"[{', '.join(f'{value:.3f}' for value in np.ravel(values))}]"


CHECKS = (goal, motion)
