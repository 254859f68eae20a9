"""LIBERO's 130 tasks, read from `tasks.json`, which `generate_tasks.py` writes. Does not import LIBERO.

A task is called `<suite>-<number>-<words>`, such as `spatial-3-on-cookie-box`: suite and number as in the literature,
then LIBERO's name without filler words and the words that the whole suite shares.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from robogauntlet.adapters.contract import TaskDescription

SUITES = {name: f"libero_{name}" for name in ("spatial", "object", "goal", "10", "90")}
"""Our names of suites to LIBERO's."""
HORIZONS = {"spatial": 220, "object": 280, "goal": 300, "10": 520, "90": 400}
"""Control steps after settling, as in OpenVLA's evaluation (experiments/robot/libero/run_libero_eval.py) and later
ones: a little more than the longest demonstration."""
TABLES = ("tabletop", "kitchen_tabletop")
"""Arenas whose table is a box and can be painted."""


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
        return TaskDescription(self.instruction, HORIZONS[self.suite], self._fixed())

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
    lists = ("fixtures", "objects", "on_ground")
    tasks = [LiberoTask(**(entry | {name: tuple(entry[name]) for name in lists})) for entry in entries]
    return {task.task: task for task in tasks}
