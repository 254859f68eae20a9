"""The tasks of robosuite that this adapter opens, and the names of their parts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from robogauntlet.adapters.contract import Goal, Moves, TaskDescription
from robogauntlet.adapters.robosuite.arms import ARMS, BY_JOINTS, DROID, MOVED_BY_JOINTS, PANDA, TWO_PANDAS, name_with

GOODS = {"Can": "red can", "Milk": "milk carton", "Bread": "bread", "Cereal": "cereal box"}
NUTS = {"Square": "peg1", "Round": "peg2"}
_IN_BINS = {"objects": "each object has its own place in the bins", "table": "it has bins in place of a table"}
_AT_PEGS = {"objects": "nuts start in a narrow strip of the table"}


def _pick_place(name: str) -> TaskDescription:
    goal = Goal(f"{name.lower()}_position", "goal_position", axes="xy", tolerance=0.08, grasped=True)
    return TaskDescription(f"put the {GOODS[name]} into its compartment of the bin", 200, fixed=_IN_BINS, goal=goal)


def _nut_assembly(name: str) -> TaskDescription:
    goal = Goal("nut_position", "peg_position", axes="xy", tolerance=0.03, grasped=True)
    return TaskDescription(f"put the {name.lower()} nut on the {name.lower()} peg", 200, fixed=_AT_PEGS, goal=goal)


WITH_ANY_ARM = {
    "Lift": TaskDescription(
        "lift the red cube off the table", horizon=80, goal=Goal("cube_position", offset=(0.0, 0.0, 0.02), grasped=True)
    ),
    "Stack": TaskDescription(
        "put the red cube on the green cube",
        horizon=180,
        goal=Goal("cubeA_position", "cubeB_position", (0.0, 0.0, 0.045), tolerance=0.02, grasped=True),
    ),
    "Door": TaskDescription(
        "turn the handle down and pull the door open",
        horizon=180,
        fixed={"table": "its table fills less than a tenth of the image"},
        goal=Goal("hinge_angle", offset=(0.3,), handle="handle_position"),
    ),
}
WITH_PANDA = {
    **WITH_ANY_ARM,
    **{f"PickPlace{name}": _pick_place(name) for name in GOODS},
    **{f"NutAssembly{name}": _nut_assembly(name) for name in NUTS},
    "Wipe": TaskDescription(
        "wipe the dirt off the table",
        horizon=200,
        fixed={"objects": "dirt lies where each seed draws its line", "dynamics": "no object is moved"},
    ),
    "ToolHang": TaskDescription(
        "put the frame into the stand and hang the wrench on its hook",
        horizon=700,
        fixed={"objects": "frame and wrench lie side by side, each as it is grasped"},
    ),
    "PickPlace": TaskDescription("put all four objects into their compartments of the bin", 1000, fixed=_IN_BINS),
    "NutAssembly": TaskDescription("put both nuts on their pegs", 600, fixed=_AT_PEGS),
}
HORIZONS_BY_JOINTS = {"Lift": 120, "Stack": 240, "TwoArmLift": 160}
"""Control steps of the tasks that are played by joints."""
TASKS = {name: replace(description, robot=PANDA) for name, description in WITH_PANDA.items()} | {
    name_with(task, arm): replace(
        description, horizon=3 * description.horizon // 2, robot=arm
    )  # Slower, see `simulation`.
    for arm in ARMS
    if arm != PANDA
    for task, description in WITH_ANY_ARM.items()
}
TASKS[name_with("TwoArmLift", TWO_PANDAS)] = TaskDescription(
    "lift the pot by its two handles",
    horizon=160,
    goal=Goal("pot_position", offset=(0.0, 0.0, 0.1), handle="handle0_position", grasped=True),
    fixed={"arm": "two arms start together", "objects": "each arm reaches one handle of the pot"},
    robot=TWO_PANDAS,
    arms=2,
)
TASKS[name_with("TwoArmHandover", TWO_PANDAS)] = TaskDescription(
    "hand the hammer to the other arm",
    horizon=400,
    fixed={
        "arm": "two arms start together",
        "objects": "only one arm reaches the hammer",
        "table": "its table is beside the middle of the image",
    },
    robot=TWO_PANDAS,
    arms=2,
)
TASKS[name_with("TwoArmPegInHole", TWO_PANDAS)] = TaskDescription(
    "put the green peg through the hole in the plate",
    horizon=100,
    fixed={
        "arm": "two arms start together",
        "objects": "peg and plate are held by the arms",
        "table": "there is no table",
    },
    robot=TWO_PANDAS,
    arms=2,
)
TASKS[name_with("TwoArmTransport", TWO_PANDAS)] = TaskDescription(
    "take the lid off, put the red cube into the other bin, and hand the hammer over into the bin where the cube was",
    horizon=700,
    fixed={
        "arm": "two arms start together",
        "objects": "each arm reaches its own bins",
        "table": "there are two tables",
    },
    robot=TWO_PANDAS,
    arms=2,
)
HELD = {"Wipe": "WipingGripper", "TwoArmPegInHole": None}
"""Tasks whose arms have no gripper, to robosuite's name of the tool in its place, if it is one."""
BY_JOINT_CONTROL = {DROID: ("Lift", "Stack"), "UR5e": ("Lift", "Stack"), TWO_PANDAS: ("TwoArmLift",)}
"""Arms to the tasks that they play by joints too."""
TASKS |= {
    name_with(task, robot := f"{arm}{end}"): replace(
        TASKS[name_with(task, TWO_PANDAS)] if arm == TWO_PANDAS else WITH_ANY_ARM[task],
        horizon=HORIZONS_BY_JOINTS[task],
        robot=robot,
        joints=tuple(f"joint_{number}" for number in range(1, MOVED_BY_JOINTS[arm].joints + 1)),
        velocities=moves is Moves.VELOCITIES,
    )
    for arm, tasks in BY_JOINT_CONTROL.items()
    for task in tasks
    for end, moves in BY_JOINTS.items()
}


@dataclass(frozen=True)
class Parts:
    """Names in `privileged_state` to names in the MuJoCo model."""

    bodies: Mapping[str, str] = field(default_factory=dict)
    marks: Mapping[str, str] = field(default_factory=dict)
    """Bodies that only show where an object has to go."""
    sites: Mapping[str, str] = field(default_factory=dict)
    angles: Mapping[str, str] = field(default_factory=dict)
    """Hinge joints."""
    lifted: str = ""
    """The body without which above the table there is no reward."""
    placed: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Bodies that can be placed elsewhere, the main object first, to the bodies that are mounted on each."""


PARTS = {
    "Lift": Parts(bodies={"cube": "cube_main"}, placed={"cube": ()}),
    "Stack": Parts(
        bodies={"cubeA": "cubeA_main", "cubeB": "cubeB_main"}, lifted="cubeA_main", placed={"cubeA": (), "cubeB": ()}
    ),
    "Door": Parts(
        bodies={"door": "Door_door", "latch": "Door_latch"},
        sites={"handle": "Door_handle"},
        angles={"hinge_angle": "Door_hinge", "latch_angle": "Door_latch_joint"},
        placed={"door": ("handle", "latch")},
    ),
    **{
        f"PickPlace{name}": Parts(bodies={name.lower(): f"{name}_main"}, marks={"goal": f"Visual{name}_main"})
        for name in GOODS
    },
    **{
        f"NutAssembly{name}": Parts(bodies={"nut": f"{name}Nut_main"}, marks={"peg": peg}) for name, peg in NUTS.items()
    },
    "TwoArmLift": Parts(
        bodies={"pot": "pot_root"},
        marks={"second_base": "robot1_base"},
        sites={"handle0": "pot_handle0", "handle1": "pot_handle1"},
    ),
    "TwoArmPegInHole": Parts(bodies={"peg": "peg_main", "plate": "hole_main"}, marks={"second_base": "robot1_base"}),
    "TwoArmTransport": Parts(
        bodies={"hammer": "payload_root", "trash": "trash_main", "lid": "transport_start_bin_lid_root"},
        marks={
            "second_base": "robot1_base",
            **{f"{name}_bin": f"transport_{name}_bin_root" for name in ("start", "target", "trash")},
        },
    ),
    "Wipe": Parts(),
    "ToolHang": Parts(bodies={"frame": "frame_root", "wrench": "tool_root", "stand": "stand_root"}),
    "TwoArmHandover": Parts(bodies={"hammer": "hammer_root"}, marks={"second_base": "robot1_base"}),
    "PickPlace": Parts(
        bodies={name.lower(): f"{name}_main" for name in GOODS},
        marks={f"{name.lower()}_goal": f"Visual{name}_main" for name in GOODS},
    ),
    "NutAssembly": Parts(
        bodies={f"{name.lower()}_nut": f"{name}Nut_main" for name in NUTS},
        marks={f"{name.lower()}_peg": peg for name, peg in NUTS.items()},
    ),
}
