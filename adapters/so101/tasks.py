"""The tasks of the SO-101, and what is where in them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from robogauntlet.adapters.contract import Goal, TaskDescription

LIMITS = {
    "shoulder_pan": (-1.91986, 1.91986),
    "shoulder_lift": (-1.74533, 1.74533),
    "elbow_flex": (-1.69, 1.69),
    "wrist_flex": (-1.65806, 1.65806),
    "wrist_roll": (-2.74385, 2.84121),
}
"""Joints of the arm, in LeRobot's order, to their least and greatest angles (rad)."""
JOINTS = tuple(LIMITS)
CUBE = 0.03
"""Edge of the cubes (m)."""
DISC = 0.03
"""Radius of the target (m), within which a cube's centre has to be."""

RED, GREEN, BLUE, YELLOW = (0.8, 0.1, 0.1, 1.0), (0.1, 0.6, 0.2, 1.0), (0.1, 0.25, 0.8, 1.0), (0.9, 0.8, 0.1, 1.0)
PURPLE, ORANGE, WHITE = (0.45, 0.15, 0.6, 1.0), (0.95, 0.5, 0.1, 1.0), (0.95, 0.95, 0.95, 1.0)

TASKS = {
    "PickPlace": TaskDescription(
        "put the red cube on the blue disc",
        horizon=120,
        goal=Goal("cube_position", "goal_position", axes="xy", tolerance=DISC, grasped=True),
        joints=JOINTS,
    ),
    "Push": TaskDescription(
        "push the green cube onto the yellow disc",
        horizon=100,
        goal=Goal("cube_position", "goal_position", axes="xy", tolerance=DISC),
        joints=JOINTS,
    ),
    "Stack": TaskDescription(
        "stack the red cube on the green cube",
        horizon=140,
        goal=Goal("red_cube_position", "green_cube_position", (0.0, 0.0, CUBE), tolerance=0.015, grasped=True),
        joints=JOINTS,
    ),
}

OTHER_COLOURS = "-other-colours"
"""End of the names of tasks with the same things in other colours."""
TASKS |= {
    f"{name}{OTHER_COLOURS}": replace(TASKS[name], instruction=instruction, variant_of=f"so101/{name}")
    for name, instruction in {
        "PickPlace": "put the purple cube on the white disc",
        "Push": "push the orange cube onto the purple disc",
        "Stack": "stack the orange cube on the purple cube",
    }.items()
}

Region = tuple[tuple[float, float], tuple[float, float]]
"""Smallest and largest x and y (m)."""


@dataclass(frozen=True)
class Layout:
    """What is on the table. Base frame."""

    cubes: Mapping[str, tuple[float, float, float, float]]
    """Names in `privileged_state` to their colours, the one that is moved first."""
    regions: Mapping[str, Region]
    """Where resets put the centres of the cubes, and of the goal."""
    disc: tuple[float, float, float, float] | None = None
    """Colour of the target."""


_NEAR = ((0.16, -0.1), (0.28, 0.1))

LAYOUTS = {
    "PickPlace": Layout({"cube": RED}, {"cube": _NEAR, "goal": _NEAR}, BLUE),
    "Push": Layout(
        {"cube": GREEN}, {"cube": ((0.16, -0.08), (0.22, 0.08)), "goal": ((0.27, -0.08), (0.3, 0.08))}, YELLOW
    ),
    "Stack": Layout({"red_cube": RED, "green_cube": GREEN}, {"red_cube": _NEAR, "green_cube": _NEAR}),
}
LAYOUTS |= {
    "PickPlace-other-colours": replace(LAYOUTS["PickPlace"], cubes={"cube": PURPLE}, disc=WHITE),
    "Push-other-colours": replace(LAYOUTS["Push"], cubes={"cube": ORANGE}, disc=PURPLE),
    "Stack-other-colours": replace(LAYOUTS["Stack"], cubes={"red_cube": ORANGE, "green_cube": PURPLE}),
}
