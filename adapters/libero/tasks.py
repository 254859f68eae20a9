"""LIBERO's 130 tasks and LIBERO-PRO's 160, read from `tasks.json`, which `generate_tasks.py` writes. Imports neither.

A task is called `<suite>-<number>-<words>`, such as `spatial-3-on-cookie-box`: suite and number as in the literature,
then LIBERO's name without filler words and the words that the whole suite shares. LIBERO-PRO's is called
`pro-<axis>-<LIBERO's task>`, such as `pro-language-goal-7-turn-on-stove`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from robogauntlet.adapters.contract import Goal, TaskDescription

PRO_AXES = {"object": "object", "swap": "swap", "task": "task", "language": "lan"}
"""LIBERO-PRO's axes to the endings of its suites: an object looks otherwise or is larger, objects change places, the
goal is another, the sentence is another. Its fifth, `env`, has no files."""
SUITES = {name: f"libero_{name}" for name in ("spatial", "object", "goal", "10", "90")} | {
    f"pro-{axis}-{name}": f"libero_{name}_{ending}"
    for axis, ending in PRO_AXES.items()
    for name in ("spatial", "object", "goal", "10")
}
"""Our names of suites to LIBERO's and LIBERO-PRO's."""
HORIZONS = {"spatial": 220, "object": 280, "goal": 300, "10": 520, "90": 400}
"""Control steps after settling, as in OpenVLA's evaluation (experiments/robot/libero/run_libero_eval.py) and later
ones: a little more than the longest demonstration."""
STORED_STATES = 50
"""Stored states of each task."""
TABLES = ("tabletop", "kitchen_tabletop")
"""Arenas whose table is a box and can be painted."""

SCENE = re.compile(r"([A-Z_]+)_SCENE(\d+)_")
"""How names of tasks begin whose suite has several scenes."""
ON_OBJECT = 0.03
"""Horizontal distance between two objects below which LIBERO's predicate `on` holds (m)."""
REGIONS = {
    r"two_layer_shelf_1_(top|bottom)_region": (0.09, "xyz"),
    r"cabinet_1_(top|middle|bottom)_region": (0.08, "xyz"),
    r"cabinet_1_top_side|shelf_1_top_side": (0.09, "xy"),
    r"tray_1_contain_region|cook_region": (0.08, "xy"),
    r"basket_1_contain_region|caddy_1_(left|right)_contain_region": (0.06, "xy"),
    r"caddy_1_(front|back)_contain_region": (0.04, "xy"),
    r"table_.*_region": (0.05, "xy"),
}
"""Places of the predicates `on` and `in` to half their width (m), and the axes that tell them from their neighbours."""
ORIGIN_ELSEWHERE = ("bottle", "frypan")
"""Objects whose origin, of which LIBERO's predicates are, is 8 cm from the centre of their shape, `<name>_position`."""
BROAD = ("plate", "book", "mug", "moka_pot")
"""Objects that can be held, or pushed, more than 6 cm from their centre."""


@dataclass(frozen=True)
class LiberoTask:
    """A task of LIBERO."""

    task: str
    """Name in RoboGauntlet."""
    suite: str
    name: str
    """LIBERO's name."""
    instruction: str
    """LIBERO's own, made from the name; LIBERO-PRO's, from the task's definition."""
    arena: str
    fixtures: tuple[str, ...]
    """Fixtures that the seed places, not the stored state: cabinet, stove, microwave, rack, caddy, shelf."""
    objects: tuple[str, ...]
    """The movable objects among LIBERO's objects of interest, in its order."""
    on_ground: tuple[str, ...]
    """Those that stand on table or floor and whose places differ between the stored states."""
    goal: tuple[str, ...]
    """Predicate, object and place of the goal, if it is that one object is on or in something; else empty."""

    @property
    def libero_suite(self) -> str:
        """LIBERO's name of the suite."""
        return SUITES[self.suite]

    @property
    def original(self) -> str:
        """The name of LIBERO's task, which LIBERO-PRO's changes."""
        return self.task.split("-", 2)[2] if self.suite.startswith("pro-") else self.task

    @property
    def published_instruction(self) -> str:
        """The instruction that the benchmark's own code makes from the name, if it is another: LIBERO's."""
        named = sentence(self.name)
        return named if named != self.instruction else ""

    @property
    def placeable(self) -> tuple[str, ...]:
        """The objects that can be moved on the ground; none unless the main object is among them."""
        return self.on_ground if self.on_ground[:1] == self.objects[:1] else ()

    @property
    def description(self) -> TaskDescription:
        """The task, as the catalog shows it."""
        return TaskDescription(
            self.instruction,
            HORIZONS[self.suite.rpartition("-")[2]],
            self._fixed(),
            goal=self._goal(),
            published_instruction=self.published_instruction,
            variant_of=f"libero/{self.original}" if self.original != self.task else "",
            start_states=STORED_STATES,
        )

    def _goal(self) -> Goal | None:
        """Return the goal, unless it has several parts, is about a fixture or rack, or not about an object's centre."""
        if not self.goal or "rack" in self.goal[2] or any(name in self.goal[1] for name in ORIGIN_ELSEWHERE):
            return None
        _, moved, place = self.goal
        sizes = (size for pattern, size in REGIONS.items() if re.search(pattern, place))
        tolerance, axes = next(sizes, (ON_OBJECT, "xy"))
        return Goal(
            f"{moved}_position",
            "goal_position",
            axes=axes,
            tolerance=tolerance,
            handle="tcp_position" if any(name in moved for name in BROAD) else "",
            grasped=not self.instruction.startswith("push"),
        )

    def _fixed(self) -> dict[str, str]:
        fixed = {}
        if not self.objects:
            fixed = dict.fromkeys(("objects", "dynamics"), "the task is about a fixture")
        elif not self.placeable:
            fixed["objects"] = f"{self.objects[0]} starts in one place, or on or in something else"
        if self.arena not in TABLES:
            surface = "the floor" if self.arena == "floor" else "a table of another shape than a box"
            fixed["table"] = f"objects stand on {surface}"
        return fixed


def sentence(name: str) -> str:
    """Return the instruction that LIBERO's own code makes from a task's name."""
    return SCENE.sub("", name).replace("_", " ")


@cache
def libero_tasks() -> Mapping[str, LiberoTask]:
    """Return the tasks by name, in the order of suites and numbers."""
    entries = json.loads(Path(__file__).with_name("tasks.json").read_text(encoding="utf-8"))
    lists = ("fixtures", "objects", "on_ground", "goal")
    tasks = [LiberoTask(**(entry | {name: tuple(entry[name]) for name in lists})) for entry in entries]
    return {task.task: task for task in tasks}
