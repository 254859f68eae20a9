"""Findings about targets of joints: units, ranges, and whether they begin where the arm is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from robogauntlet.adapters.contract import ActionSpec, FloatArray
from robogauntlet.orchestrator.policy_kit.actions import constant
from robogauntlet.orchestrator.policy_kit.finding import Finding, Level, percent
from robogauntlet.orchestrator.policy_kit.recording import Play

LARGEST = 2 * np.pi
"""Numbers beyond this are not radians."""
FAR = 0.5
"""A first target that is farther than this from where the joint is has another meaning (rad)."""


def targets(plays: Sequence[Play], spec: ActionSpec) -> Iterator[Finding]:
    """Units, distance from the arm's start, and the shares beyond the joints' ranges and speeds."""
    yield from constant(np.concatenate([play.actions() for play in plays]))
    each = [play.actions()[:, :-1] for play in plays]
    values, names = np.concatenate(each), spec.names[:-1]
    largest = float(np.abs(values).max())
    if largest > LARGEST:
        text = f"numbers up to {largest:.3g} are not radians: degrees (joint_scale: 0.01745), or another scale?"
        yield Finding("targets", Level.WARNING, text, {"largest_rad": largest})
        return
    gaps = np.array([np.abs(actions[0] - play.joint_angles) for actions, play in zip(each, plays, strict=True)])
    farthest, gap = names[int(gaps.max(axis=0).argmax())], float(gaps.max())
    beyond = (values < spec.low[:-1] - 1e-9) | (values > spec.high[:-1] + 1e-9)
    share = float(beyond.any(axis=1).mean())
    numbers = {"share_outside": share, "largest_rad": largest, "first_gap_rad": gap}
    if gap > FAR:
        text = (
            f"the first target is {gap:.2g} rad from where {farthest} is: changes instead of targets, or another zero, "
            "sign, scale or order of the joints?"
        )
        yield Finding("targets", Level.WARNING, text, numbers)
    elif share:
        which = ", ".join(name for name, left in zip(names, beyond.any(axis=0), strict=True) if left)
        text = f"{percent(share)} of the actions have targets beyond a joint's range, and are clipped ({which})"
        yield Finding("targets", Level.WARNING if share > 0.5 else Level.NOTE, text, numbers)
    else:
        yield Finding("targets", Level.OK, f"within the joints' ranges; the first is {gap:.2g} rad away", numbers)
    yield _speed(each, spec)


def _speed(each: Sequence[FloatArray], spec: ActionSpec) -> Finding:
    changes = np.concatenate([np.abs(np.diff(actions, axis=0)) for actions in each])
    largest = float(changes.max(initial=0.0))
    share = float((changes > spec.steps[:-1] + 1e-9).any(axis=1).mean()) if len(changes) else 0.0
    numbers = {"share_fast": share, "largest_change_rad": largest}
    text = f"targets change by up to {largest:.3g} rad per step"
    if share == 0:
        return Finding("speed", Level.OK, f"{text}, and the joints can follow", numbers)
    text += f"; in {percent(share)} of the steps a joint cannot follow, and lags behind"
    return Finding("speed", Level.WARNING if share > 0.5 else Level.NOTE, text, numbers)
