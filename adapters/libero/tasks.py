"""LIBERO's 130 tasks, read from `tasks.json`, which `generate_tasks.py` writes. Does not import LIBERO.

A task is called `<suite>-<number>-<words>`, such as `spatial-3-on-cookie-box`: suite and number as in the literature,
then LIBERO's name without filler words and the words that the whole suite shares.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from robogauntlet.adapters.contract import Goal, TaskDescription

SUITES = {name: f"libero_{name}" for name in ("spatial", "object", "goal", "10", "90")}
"""Our names of suites to LIBERO's."""
HORIZONS = {"spatial": 220, "object": 280, "goal": 300, "10": 520, "90": 400}
"""Control steps after settling, as in OpenVLA's evaluation (experiments/robot/libero/run_libero_eval.py) and later
ones: a little more than the longest demonstration."""
STORED_STATES = 50
"""Stored states of each task."""
TABLES = ("tabletop", "kitchen_tabletop")
"""Arenas whose table is a box and can be painted."""

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
ORIGIN_ELSEWHERE = ("wine_bottle", "frypan")
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
    def placeable(self) -> tuple[str, ...]:
        """The objects that can be moved on the ground; none unless the main object is among them."""
        return self.on_ground if self.on_ground[:1] == self.objects[:1] else ()

    @property
    def description(self) -> TaskDescription:
        """The task, as the catalog shows it."""
        return TaskDescription(
            self.instruction, HORIZONS[self.suite], self._fixed(), goal=self._goal(), start_states=STORED_STATES
        )

    def _goal(self) -> Goal | None:
        """Return the goal, unless it has several parts, is about a fixture, or is not about an object's centre."""
        if not self.goal or any(name in self.goal[1] for name in ORIGIN_ELSEWHERE):
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
            grasped=not moved.startswith("plate"),
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


@cache
def libero_tasks() -> Mapping[str, LiberoTask]:
    """Return the tasks by name, in the order of suites and numbers."""
    entries = json.loads(Path(__file__).with_name("tasks.json").read_text(encoding="utf-8"))
    lists = ("fixtures", "objects", "on_ground", "goal")
    tasks = [LiberoTask(**(entry | {name: tuple(entry[name]) for name in lists})) for entry in entries]
    return {task.task: task for task in tasks}
