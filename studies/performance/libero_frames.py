"""The same as `frames` in LIBERO, after `robogauntlet env create libero`."""

from studies.percent import few
from studies.performance import frames

TASKS = (
    "libero/spatial-0-between-plate-ramekin",
    "libero/object-0-alphabet-soup",
    "libero/goal-1-put-bowl-on-stove",
    "libero/10-0-livingroom2-put-both-alphabet-soup-tomato-sauce-in-basket",
    "libero/10-3-kitchen4-put-black-bowl-in-bottom-drawer-cabinet-close",
)


def measure() -> list[dict[str, object]]:
    """Milliseconds per observation of one camera of 96 px, medians, and triangles drawn."""
    return frames.measure(TASKS[: few(len(TASKS))])
