"""Findings about targets of joints: units, ranges, and whether they begin where the arm is; and about velocities."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from robogauntlet.adapters.contract import ActionSpec, FloatArray
from robogauntlet.orchestrator.kit.finding import Finding, Level, percent
from robogauntlet.orchestrator.kit.policy.actions import constant
from robogauntlet.orchestrator.kit.policy.motion import HELD
from robogauntlet.orchestrator.kit.policy.recording import Play

LARGEST = 2 * np.pi
"""Larger numbers, if they are also far beyond a joint's range, are not radians."""
FAR = 0.5
"""A first target that is farther than this from where the joint is has another meaning (rad)."""


def targets(plays: Sequence[Play], spec: ActionSpec) -> Iterator[Finding]:
    """Units, distance from the arm's start, and the shares beyond the joints' ranges and speeds."""
    used = [index for index in range(len(spec.joints)) if index not in spec.ignored_indices]
    each, offsets = ([actions[:, used] for actions in both] for both in zip(*map(_both, plays), strict=True))
    if max(float(np.abs(one).max()) for one in offsets) <= HELD:
        yield Finding("motion", Level.WARNING, "no target leaves where the arm starts: the policy stands still")
    else:
        yield from constant(np.concatenate([play.actions() for play in plays]))
    values, low, high = np.concatenate(each), spec.low[used], spec.high[used]
    largest = float(np.abs(values).max())
    if largest > max(LARGEST, 1.5 * float(np.abs([low, high]).max())):
        text = f"numbers up to {largest:.3g} are not radians: degrees (joint_scale: 0.01745), or another scale?"
        yield Finding("targets", Level.WARNING, text, {"largest": largest})
        return
    names = [spec.names[index] for index in used]
    gaps = np.abs([one[0] for one in offsets]).max(axis=0)
    gap, beyond = float(gaps.max()), (values < low - 1e-9) | (values > high + 1e-9)
    share = float(beyond.any(axis=1).mean())
    numbers = {"share_outside": share, "largest_rad": largest, "first_gap_rad": gap}
    if gap > FAR:
        text = (
            f"the first target is {gap:.2g} rad from where {names[int(gaps.argmax())]} is: changes instead of targets, "
            "or another zero, sign, scale or order of the joints?"
        )
        yield Finding("targets", Level.WARNING, text, numbers)
    elif share:
        which = ", ".join(name for name, left in zip(names, beyond.any(axis=0), strict=True) if left)
        text = f"{percent(share)} of the actions have targets beyond a joint's range, and are clipped ({which})"
        yield Finding("targets", Level.WARNING if share > 0.5 else Level.NOTE, text, numbers)
    else:
        text = f"within the joints' ranges; the first are at most {gap:.2g} rad from where the joints are"
        yield Finding("targets", Level.OK, text, numbers)
    if max(map(len, each)) > 1:
        yield _speed(each, spec.steps[used])


def velocities(plays: Sequence[Play], spec: ActionSpec) -> Iterator[Finding]:
    """Whether joints are moved, and the share of actions beyond their largest velocities."""
    actions = np.concatenate([play.actions() for play in plays])
    used = [index for index in range(len(spec.joints)) if index not in spec.ignored_indices]
    values, high = np.abs(actions[:, used]), spec.high[used]
    largest, share = float(values.max()), float((values > high + 1e-9).any(axis=1).mean())
    if not largest:
        yield Finding("motion", Level.WARNING, "all velocities are 0: the policy stands still")
        return
    yield from constant(actions)
    text = f"up to {largest:.3g} rad/s"
    if share:
        text += f"; {percent(share)} of the actions are beyond the limit of {high.max():.3g} rad/s, and are clipped"
        text += ": targets, or degrees?" if share > 0.5 else ""
    level = Level.WARNING if share > 0.5 else Level.NOTE if share else Level.OK
    yield Finding("velocities", level, text, {"share_outside": share, "largest_rad_per_s": largest})


def _both(play: Play) -> tuple[FloatArray, FloatArray]:
    return play.actions(), play.offsets()


def _speed(each: Sequence[FloatArray], limits: FloatArray) -> Finding:
    changes = np.concatenate([np.abs(np.diff(targets, axis=0)) for targets in each])
    largest, share = float(changes.max()), float((changes > limits + 1e-9).any(axis=1).mean())
    numbers = {"share_fast": share, "largest_change_rad": largest}
    text = f"after the first, targets change by up to {largest:.3g} rad per step"
    if share == 0:
        return Finding("speed", Level.OK, f"{text}, and the joints can follow", numbers)
    text += f"; in {percent(share)} of the steps a joint cannot follow, and lags behind"
    return Finding("speed", Level.WARNING if share > 0.5 else Level.NOTE, text, numbers)
