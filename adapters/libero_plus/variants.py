"""LIBERO-Plus's 10,030 tasks, read from `variants.json`, which `generate_variants.py` writes. Imports neither package.

A task is one of LIBERO's with one variant of one of seven axes, and is called `<axis>-<suite>-<number>-<variant>`, such
as `robot-goal-7-448`: suite and number as in `libero/goal-7-turn-on-stove`, the variant's numbers as in LIBERO-Plus's
own name, `turn_on_the_stove_view_0_0_100_0_0_initstate_448`. In `10` the scene is between them:
`robot-10-5-study1-316`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from pathlib import Path

from robogauntlet.adapters.contract import TaskDescription
from robogauntlet.adapters.libero.tasks import STORED_STATES, LiberoTask, libero_tasks
from robogauntlet.adapters.libero_plus.task_files import rewritten_instruction

OWN_VIEW = (0, 0, 100, 0, 0)
"""The numbers of a view that is LIBERO's own."""
REJECTED = "no instruction"
"""Key in the file of the rewritten instructions that are none."""
NO_INSTRUCTION = "its rewritten sentence is no instruction but announces some"


class PlusAxis(StrEnum):
    """LIBERO-Plus's axes. The first three need nothing but LIBERO."""

    CAMERA = "camera"
    ROBOT = "robot"
    NOISE = "noise"
    LANGUAGE = "language"
    LIGHT = "light"
    BACKGROUND = "background"
    LAYOUT = "layout"


@dataclass(frozen=True)
class Variant:
    """A task of LIBERO-Plus."""

    axis: PlusAxis
    base: LiberoTask
    code: str
    """The end of the task's name, such as `448`, `30-15-120-0-0` or `moved-2-1`."""

    @property
    def task(self) -> str:
        """Name in RoboGauntlet."""
        return f"{self.axis}-{short_name(self.base)}-{self.code}"

    @property
    def numbers(self) -> tuple[int, ...]:
        """The numbers of the variant."""
        return tuple(int(part) for part in self.code.split("-") if part.isdecimal())

    @property
    def view(self) -> tuple[int, ...]:
        """Where the camera is: two angles (deg), distance (%), and two more angles (deg), see `camera_pose`."""
        return self.numbers if self.axis is PlusAxis.CAMERA else OWN_VIEW

    @property
    def start(self) -> int:
        """Number of the arm's posture; 0 for LIBERO's own."""
        return self.numbers[0] if self.axis is PlusAxis.ROBOT else 0

    @property
    def noise(self) -> int:
        """Number of the image noise, 1 to 50; 0 for none."""
        return self.numbers[0] if self.axis is PlusAxis.NOISE else 0

    @property
    def file(self) -> str:
        """Name of its task file, without the suffix: LIBERO's own for cameras, starts and noise."""
        match self.axis:
            case PlusAxis.CAMERA | PlusAxis.ROBOT | PlusAxis.NOISE:
                return self.base.name
            case PlusAxis.LAYOUT if not self.code.startswith("add"):
                kind, level, sample = self.code.split("-")
                moved = "moved_" if kind == "moved" else ""
                return f"{self.base.name}_{moved}level{level}_sample{sample}"
            case PlusAxis.LANGUAGE | PlusAxis.LIGHT:
                return f"{self.base.name}_{self.axis}_{self.code}"
        return f"{self.base.name}_{self.code.replace('-', '_')}"

    @property
    def name(self) -> str:
        """LIBERO-Plus's own name."""
        if self.axis in (PlusAxis.LAYOUT, PlusAxis.LIGHT, PlusAxis.BACKGROUND):
            return self.file
        named = f"{self.file}_view_{'_'.join(map(str, self.view))}_initstate_{self.start}"
        return f"{named}_noise_{self.noise}" if self.noise else named

    @property
    def published_instruction(self) -> str:
        """The instruction that LIBERO-Plus's own benchmark gives, with the variant's name; empty for rewritten ones."""
        if self.axis is PlusAxis.LANGUAGE:
            return ""
        return self.base.instruction + self.name.removeprefix(self.base.name).replace("_", " ")

    @property
    def instruction(self) -> str:
        """LIBERO's instruction, or the rewritten one; what that is, if LIBERO-Plus is not installed here."""
        if self.axis is PlusAxis.LANGUAGE:
            rewritten = rewritten_instruction(self.base.libero_suite, self.file)
            return rewritten or f"LIBERO-Plus's rewording of: {self.base.instruction}"
        return self.base.instruction

    @property
    def is_no_instruction(self) -> bool:
        """Whether its rewritten instruction is none, such as the beginning of a list of them."""
        return self.axis is PlusAxis.LANGUAGE and self.numbers[0] in _no_instructions().get(short_name(self.base), ())

    @property
    def description(self) -> TaskDescription:
        """The task, as the catalog shows it."""
        own = _description(self.base.task)
        return TaskDescription(
            f"left out: {NO_INSTRUCTION}" if self.is_no_instruction else self.instruction,
            own.horizon,
            goal=own.goal,
            published_instruction=self.published_instruction,
            variant_of=f"libero/{self.base.task}",
            start_states=1 if self.axis is PlusAxis.LAYOUT else STORED_STATES,
        )


class VariantTasks(Mapping[str, TaskDescription]):
    """The descriptions of all tasks by name, each made when it is first looked up."""

    def __getitem__(self, task: str) -> TaskDescription:
        return _variant_description(task)

    def __iter__(self) -> Iterator[str]:
        return iter(_names())

    def __len__(self) -> int:
        return len(_names())


def variant(task: str) -> Variant:
    """Return the variant of that name. Raises KeyError."""
    base, axis, code = _names()[task]
    return Variant(axis, base, code)


def variants() -> Iterator[Variant]:
    """Yield all variants, by axis, then by task of LIBERO."""
    return map(variant, _names())


def short_name(base: LiberoTask) -> str:
    """Return suite and number of a task of LIBERO, `goal-7`, and its scene if the suite has several, `10-5-study1`."""
    return "-".join(base.task.split("-", 3)[: 3 if base.suite == "10" else 2])


@cache
def _variant_description(task: str) -> TaskDescription:
    return variant(task).description


@cache
def _description(task: str) -> TaskDescription:
    return libero_tasks()[task].description


@cache
def _index() -> Mapping[str, Mapping[str, list[int | str]]]:
    return dict(json.loads(Path(__file__).with_name("variants.json").read_text(encoding="utf-8")))


def _no_instructions() -> Mapping[str, list[int | str]]:
    """Return the codes of rewritten instructions that are none, by task of LIBERO."""
    return _index()[REJECTED]


@cache
def _names() -> Mapping[str, tuple[LiberoTask, PlusAxis, str]]:
    index = _index()
    bases = {short_name(base): base for base in libero_tasks().values()}
    return {
        f"{axis}-{short}-{code}": (bases[short], axis, str(code))
        for axis in PlusAxis
        for short, codes in index[axis].items()
        for code in codes
    }
