"""The tasks of ManiSkill that this adapter opens, and what is where in them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from robogauntlet.adapters.contract import Goal, TaskDescription

ADJUSTS = frozenset({"cameras", "lights", "objects", "arm", "dynamics", "table"})
"""Scene controls, of tasks of Pandas that are moved by their tools."""
ONTO_TARGET = Goal("cube_position", "goal_position", axes="xy", tolerance=0.1)

TASKS = {
    "PushCube-v1": TaskDescription("push the blue cube onto the red and white target", horizon=45, goal=ONTO_TARGET),
    "PullCube-v1": TaskDescription("pull the blue cube onto the red and white target", horizon=32, goal=ONTO_TARGET),
    "StackCube-v1": TaskDescription(
        "stack the red cube on top of the green cube",
        horizon=100,
        goal=Goal("red_cube_position", "green_cube_position", (0.0, 0.0, 0.04), tolerance=0.03, grasped=True),
    ),
    "PickCube-v1": TaskDescription(
        "pick up the red cube and hold it in the green ball",
        horizon=80,
        goal=Goal("cube_position", "goal_position", tolerance=0.025, grasped=True),
    ),
    "PlaceSphere-v1": TaskDescription(
        "put the blue sphere into the bin",
        horizon=100,
        goal=Goal("sphere_position", "bin_position", (0.0, 0.0, 0.0225), tolerance=0.01, grasped=True),
    ),
    "StackPyramid-v1": TaskDescription(
        "build a pyramid with the blue cube on the other two",
        horizon=250,
        goal=Goal("blue_cube_position", offset=(0.0, 0.0, 0.03), grasped=True),
    ),
    "LiftPegUpright-v1": TaskDescription(
        "set the peg upright", horizon=150, goal=Goal("peg_position", offset=(0.0, 0.0, 0.09), axes="z", grasped=True)
    ),
    "PokeCube-v1": TaskDescription(
        "push the red cube onto the target with the peg",
        horizon=100,
        goal=Goal("cube_position", "goal_position", axes="xy", tolerance=0.05, handle="peg_position"),
    ),
    "PullCubeTool-v1": TaskDescription("pull the blue cube towards the robot with the tool", horizon=130),
    "PlugCharger-v1": TaskDescription(
        "plug the charger into the socket",
        horizon=200,
        goal=Goal("charger_position", "socket_position", tolerance=0.005, grasped=True),
    ),
    "RollBall-v1": TaskDescription(
        "roll the blue ball onto the red and white target",
        horizon=200,
        goal=Goal("ball_position", "goal_position", axes="xy", tolerance=0.1),
    ),
    "TwoRobotPickCube-v1@TwoPandas": TaskDescription(
        "hand the red cube to the other arm at the green ball",
        horizon=150,
        goal=Goal("cube_position", "goal_position", tolerance=0.025, grasped=True),
        fixed={"arm": "two arms start together", "objects": "only one arm reaches the cube"},
        robot="TwoPandas",
        arms=2,
    ),
    "TwoRobotStackCube-v1@TwoPandas": TaskDescription(
        "put the green cube onto the red and white target with one arm and the blue cube on it with the other",
        horizon=200,
        goal=Goal("blue_cube_position", "green_cube_position", (0.0, 0.0, 0.04), tolerance=0.03, grasped=True),
        fixed={"arm": "two arms start together", "objects": "each arm reaches one cube"},
        robot="TwoPandas",
        arms=2,
    ),
}

Region = tuple[tuple[float, float], tuple[float, float]]
"""Smallest and largest x and y (m)."""


def _square(x: float, y: float) -> Region:
    return (-x, -y), (x, y)


@dataclass(frozen=True)
class Layout:
    """Names and places in a task's scene.

    World frame: the origin is on the table, 0.615 m in front of the base; between two arms, 0.75 m in front of each; in
    RollBall 1 m in front and 0.1 m to the left.
    """

    look_at: tuple[float, float, float]
    """Target of the third-person camera (m)."""
    objects: Mapping[str, str] = field(default_factory=dict)
    """Names in `privileged_state` to ManiSkill's actors, of what can be moved."""
    regions: Mapping[str, Region] = field(default_factory=dict)
    """Where resets put the centres of these objects."""
    fixtures: Mapping[str, str] = field(default_factory=dict)
    """The same as `objects`, of what stands still."""
    goal: str | None = None
    """ManiSkill's actor of the goal."""
    eye: tuple[float, float, float] = (0.5, 0.5, 0.5)
    """The third-person camera relative to its target (m)."""
    usual_pixel: float = 153.0
    """Usual value of a pixel, for which changes of light are exact: lower where the floor fills much of the image."""


_ABOVE = (0.0, 0.0, 0.05)
_TWO = {"red_cube": "cubeA", "green_cube": "cubeB"}
_THREE = _TWO | {"blue_cube": "cubeC"}

LAYOUTS = {
    "PushCube-v1": Layout((0.08, 0.0, 0.05), {"cube": "cube"}, {"cube": _square(0.1, 0.1)}, goal="goal_region"),
    "PullCube-v1": Layout((-0.08, 0.0, 0.05), {"cube": "cube"}, {"cube": _square(0.1, 0.1)}, goal="goal_region"),
    "StackCube-v1": Layout(_ABOVE, _TWO, dict.fromkeys(_TWO, _square(0.2, 0.3))),
    "PickCube-v1": Layout((0.0, 0.0, 0.1), {"cube": "cube"}, {"cube": _square(0.1, 0.1)}, goal="goal_site"),
    "PlaceSphere-v1": Layout(
        _ABOVE, {"sphere": "sphere"}, {"sphere": ((-0.1, -0.1), (-0.05, 0.1))}, fixtures={"bin": "bin"}
    ),
    "StackPyramid-v1": Layout(_ABOVE, _THREE, dict.fromkeys(_THREE, _square(0.1, 0.2))),
    "LiftPegUpright-v1": Layout(_ABOVE, {"peg": "peg"}, {"peg": _square(0.1, 0.1)}),
    "PokeCube-v1": Layout(
        (0.1, 0.0, 0.05),
        {"cube": "cube", "peg": "peg"},
        {"cube": ((0.12, -0.1), (0.32, 0.1)), "peg": _square(0.1, 0.1)},
        goal="goal_region",
    ),
    "PlugCharger-v1": Layout(
        (0.0, 0.0, 0.08),
        {"charger": "charger"},
        {"charger": ((-0.1, -0.2), (-0.026, 0.2))},
        fixtures={"socket": "receptacle"},
        eye=(0.35, 0.6, 0.5),
    ),
    "RollBall-v1": Layout(
        (-0.1, 0.12, 0.0),
        {"ball": "ball"},
        {"ball": ((-0.4, 0.5), (0.2, 0.7))},
        goal="goal_region",
        eye=(1.9, -0.9, 2.0),
        usual_pixel=132.0,
    ),
    "TwoRobotPickCube-v1@TwoPandas": Layout(
        (0.0, 0.0, 0.1), eye=(0.6, 0.6, 0.5), objects={"cube": "cube"}, goal="goal_site"
    ),
    "TwoRobotStackCube-v1@TwoPandas": Layout(
        (0.0, 0.0, 0.1), {"blue_cube": "cubeA", "green_cube": "cubeB"}, goal="goal_region", eye=(0.6, 0.6, 0.5)
    ),
    "PullCubeTool-v1": Layout(
        (0.05, -0.05, 0.05),
        {"cube": "cube", "tool": "l_shape_tool"},
        {"cube": ((0.05, -0.25), (0.25, 0.05)), "tool": ((-0.3, -0.3), (-0.1, -0.1))},
    ),
}
