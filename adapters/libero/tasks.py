"""LIBERO's 130 tasks, read from `tasks.json`, which `adapters.libero.survey` wrote. Imports nothing of LIBERO.

A task is called `<suite>-<number>-<words>`, such as `spatial-3-on-cookie-box`: the suite and the number as the
literature has them, then what is left of LIBERO's name without what the whole suite has in common and filler words.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from adapters.contract import TaskCard

SUITES = {"spatial": "libero_spatial", "object": "libero_object", "goal": "libero_goal"} | {
    "10": "libero_10",
    "90": "libero_90",
}
"""Our names of the suites to LIBERO's."""
HORIZONS = {"spatial": 220, "object": 280, "goal": 300, "10": 520, "90": 400}
"""Control steps after the settling, as OpenVLA evaluates (experiments/robot/libero/run_libero_eval.py) and others after
it: a little more than the longest demonstration takes."""
TABLES = ("tabletop", "kitchen_tabletop")
"""Arenas whose table is a box, which can be painted."""


@dataclass(frozen=True)
class LiberoTask:
    """A task of LIBERO."""

    task: str
    """Our name."""
    suite: str
    name: str
    """LIBERO's own name."""
    instruction: str
    arena: str
    fixtures: tuple[str, ...]
    """What the seed places, and the stored state does not hold: cabinet, stove, microwave, rack, caddy, shelf."""
    things: tuple[str, ...]
    """The movable ones of LIBERO's objects of interest, in its order."""
    standing: tuple[str, ...]
    """Those of the things that stand on table or floor, and not in the same place in all stored states."""

    @property
    def libero_suite(self) -> str:
        """LIBERO's name of the suite."""
        return SUITES[self.suite]

    @property
    def placeable(self) -> tuple[str, ...]:
        """The things that can be put elsewhere on the ground: none unless what the task is about is among them."""
        return self.standing if self.standing[:1] == self.things[:1] else ()

    @property
    def card(self) -> TaskCard:
        """The task, as the catalog shows it."""
        return TaskCard(self.instruction, HORIZONS[self.suite], self._fixed())

    def _fixed(self) -> dict[str, str]:
        fixed = {}
        if not self.things:
            fixed = dict.fromkeys(("objects", "bodies"), "the task is about a fixture")
        elif not self.placeable:
            fixed["objects"] = f"{self.things[0]} starts in one place, or on or in something else"
        if self.arena not in TABLES:
            surface = "the floor" if self.arena == "floor" else "a table of another shape than a box"
            fixed["stage"] = f"things stand on {surface}"
        return fixed


@cache
def libero_tasks() -> Mapping[str, LiberoTask]:
    """Our name of a task to the task, in the order of suites and numbers."""
    read = json.loads(Path(__file__).with_name("tasks.json").read_text(encoding="utf-8"))
    lists = ("fixtures", "things", "standing")
    tasks = [LiberoTask(**(entry | {name: tuple(entry[name]) for name in lists})) for entry in read]
    return {task.task: task for task in tasks}
