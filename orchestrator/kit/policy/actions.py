"""Findings about the numbers of a policy's actions: units, limits, gripper, and how they come."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from robogauntlet.adapters.contract import ACTION_NAMES, ActionSpec, FloatArray
from robogauntlet.orchestrator.kit.finding import Finding, Level, percent
from robogauntlet.orchestrator.kit.policy.recording import Play

NORMALISED = 1.5
"""Numbers up to this look as if they were normalised to [-1, 1]."""
SMALL = 1e-3
"""Translations below this hardly move the tool (m per step)."""
POSE_DISTANCE = 0.15
"""Translations within this distance of the tool's position look like positions (m)."""


def answers(plays: Sequence[Play], replan_every: int) -> Iterator[Finding]:
    """Chunk length and answer times."""
    lengths = sorted({len(answer.chunk) for play in plays for answer in play.answers})
    words = str(lengths[0]) if len(lengths) == 1 else f"{lengths[0]} to {lengths[-1]}"
    executed = min(lengths[-1], replan_every)
    used = "all executed" if executed == lengths[-1] else f"{executed} executed before the next query (replan_every)"
    yield Finding("chunk", Level.OK, f"chunks of {words} actions, {used}", {"longest": lengths[-1]})
    first, *later = [1000 * answer.seconds for play in plays for answer in play.answers]
    text, numbers = f"first answer {first:.1f} ms", {"first_ms": first}
    if later:
        median, p95 = (float(value) for value in np.percentile(later, [50, 95]))
        numbers |= {"median_ms": median, "p95_ms": p95, "slowest_ms": max(later)}
        text += f", later ones {median:.1f} ms (median of {len(later)}), slowest {max(later):.1f} ms"
        if 1 <= round(median) < round(p95):
            text += f"; modelled by run --latency {median:.0f}-{p95:.0f}ms"
    yield Finding("latency", Level.NOTE, text, numbers)


def limits(plays: Sequence[Play], spec: ActionSpec) -> Iterator[Finding]:
    """Units, and the share of actions outside the simulation's limits."""
    actions = np.concatenate([play.actions() for play in plays])
    if not actions[:, :6].any():
        yield Finding("motion", Level.WARNING, "all translations and rotations are 0: the policy stands still")
        return
    yield from constant(actions)
    yield from _translation(plays, actions[:, :3], spec.max_translation)
    turned = [name for name in ACTION_NAMES[3:6] if name not in spec.ignored]
    if turned and spec.max_rotation:
        yield _rotation(actions[:, 3:6], spec.max_rotation)


def native(plays: Sequence[Play], spec: ActionSpec) -> Iterator[Finding]:
    """The range of each of the environment's own numbers, and the share outside its bounds."""
    actions = np.concatenate([play.actions() for play in plays])
    yield from constant(actions)
    outside = (actions < spec.low - 1e-9) | (actions > spec.high + 1e-9)
    for number, values, beyond in zip(spec.numbers, actions.T, outside.T, strict=True):
        share, lowest, highest = float(beyond.mean()), float(values.min()), float(values.max())
        text = f"{lowest:.3g} to {highest:.3g}, within {number.low:g} to {number.high:g}"
        if share:
            text = f"{text.replace('within', 'bounds')}: {percent(share)} of the actions are clipped"
        numbers = {"share_outside": share, "lowest": lowest, "highest": highest}
        yield Finding(number.name, Level.WARNING if share > 0.5 else Level.OK, text, numbers)


def constant(actions: FloatArray) -> Iterator[Finding]:
    """Whether all actions, shape (steps, numbers of an action), are the same."""
    if len(actions) > 1 and (actions == actions[0]).all():
        numbers = ", ".join(f"{value:.3g}" for value in actions[0])
        yield Finding("motion", Level.WARNING, f"all {len(actions)} actions are the same: {numbers}")


def _translation(plays: Sequence[Play], moves: FloatArray, limit: float) -> Iterator[Finding]:
    sizes = np.abs(moves).max(axis=1)
    share, typical, largest = float((sizes > limit + 1e-9).mean()), float(np.median(sizes)), float(sizes.max())
    numbers = {"share_outside": share, "median_m": typical, "largest_m": largest, "limit_m": limit}
    if largest == 0:
        yield Finding("translation", Level.WARNING, "all translations are 0: the tool is only turned", numbers)
        return
    if share > 0.5 and _are_positions(plays):
        text = (
            "translations are close to the tool's own position: expected displacements per step, not target positions"
        )
        yield Finding("translation", Level.WARNING, text, numbers)
        return
    outside = f"{percent(share)} of the actions are beyond the limit of {limit:.3g} m per step, and are clipped"
    if typical > 3 * limit and largest <= NORMALISED:
        yield Finding(
            "translation",
            Level.WARNING,
            f"{outside}; numbers of about {typical:.2g} up to {largest:.2g} look normalised to [-1, 1], expected "
            "metres: multiply by the metres that 1 stands for (translation_scale)",
            numbers,
        )
    elif largest > NORMALISED:
        text = f"{outside}; numbers up to {largest:.3g} are not metres per step: millimetres, or not scaled back?"
        yield Finding("translation", Level.WARNING, text, numbers)
    elif share:
        level = Level.WARNING if share > 0.5 else Level.NOTE
        yield Finding("translation", level, f"{outside}; the largest is {largest:.3g} m", numbers)
    elif largest < SMALL:
        text = f"at most {1000 * largest:.2g} mm per step, the limit is {1000 * limit:.0f} mm: the tool hardly moves"
        yield Finding("translation", Level.WARNING, text, numbers)
    else:
        text = f"up to {largest:.3g} m per step, within the limit of {limit:.3g} m"
        yield Finding("translation", Level.OK, text, numbers)


def _are_positions(plays: Sequence[Play]) -> bool:
    """Whether the translations follow the tool's position."""
    gaps = np.concatenate([np.linalg.norm(play.actions()[:, :3] - play.tool[:-1], axis=1) for play in plays])
    reach = np.concatenate([np.linalg.norm(play.tool[:-1], axis=1) for play in plays])
    return bool(np.median(gaps) < POSE_DISTANCE < np.median(reach))


def _rotation(turns: FloatArray, limit: float) -> Finding:
    sizes = np.abs(turns).max(axis=1)
    share, largest = float((sizes > limit + 1e-9).mean()), float(sizes.max())
    numbers = {"share_outside": share, "largest_rad": largest, "limit_rad": limit}
    if share == 0:
        text = f"up to {largest:.3g} rad per step, within the limit of {limit:.3g} rad"
        return Finding("rotation", Level.OK, text, numbers)
    text = f"{percent(share)} of the actions are beyond the limit of {limit:.3g} rad per step, and are clipped"
    if largest > np.pi:
        text += f"; the largest number is {largest:.3g}: degrees, or absolute angles?"
    elif largest > 3 * limit:
        text += f"; the largest is {largest:.3g}: normalised to [-1, 1] (rotation_scale), or absolute angles?"
    return Finding("rotation", Level.WARNING if share > 0.5 or largest > np.pi else Level.NOTE, text, numbers)


def gripper(plays: Sequence[Play], spec: ActionSpec) -> Iterator[Finding]:
    """What the last number does over the episodes."""
    values = np.concatenate([play.actions()[:, -1] for play in plays])
    low, high, distinct = float(values.min()), float(values.max()), np.unique(np.round(values, 6))
    numbers = {"lowest": low, "highest": high, "distinct": float(len(distinct))}
    if len(distinct) == 1:
        kind = f"always {low:g}"
    elif len(distinct) == 2:
        kind = f"two values, {low:g} and {high:g}"
    else:
        kind = f"continuous, from {low:.3g} to {high:.3g}"
    level, remark = Level.OK, ""
    if low < -1 - 1e-6 or high > 1 + 1e-6:
        level, remark = Level.WARNING, "expected -1 (open) to 1 (closed)"
    elif low >= -1e-6 and len(distinct) > 1:
        level = Level.WARNING
        remark = "expected -1 (open) to 1 (closed); if they are 0 to 1, set gripper_open and gripper_closed"
    elif high <= 0:
        level, remark = Level.NOTE, "it never closes"
    elif low > 0:
        level, remark = Level.NOTE, "it never opens"
    else:
        switches = int((np.diff(np.sign(values)) != 0).sum())
        remark = f"it opens and closes ({switches} changes)"
    if "gripper" in spec.ignored:
        remark += "; this task ignores the gripper"
    yield Finding("gripper", level, f"{kind}: {remark}", numbers)
