"""Writes `tasks.json`: `python -m robogauntlet.adapters.libero.generate_tasks`, where LIBERO is installed.

The file has all that the catalog needs without importing LIBERO and LIBERO-PRO. A test compares it with the package.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.adapters.libero.libero_import import import_libero
from robogauntlet.adapters.libero.tasks import SCENE, SUITES, sentence

SAME = 1e-3
"""Positions within this distance count as equal (m)."""
FREE = 10
"""Index of the first movable object's pose in a stored state, after time, seven joints and two fingers."""
FILLERS = {"the", "of", "and", "it", "a", "up"}


def survey() -> list[dict[str, Any]]:
    """Return every task of all suites, in LIBERO's order."""
    package = import_libero()
    return [entry for suite in SUITES for entry in _suite(suite, package.task_map[SUITES[suite]], package)]


def _suite(suite: str, names: Sequence[str], package: Any) -> Iterator[dict[str, Any]]:
    """Yield a suite's tasks. Our names omit words with which all of LIBERO's names begin or end."""
    words = {name: [*SCENE.sub(_scene, name).split("_")] for name in names}
    head, tail = _shared(list(words.values())), _shared([each[::-1] for each in words.values()])
    for number, name in enumerate(names):
        short = [word for word in words[name][head : len(words[name]) - tail] if word not in FILLERS]
        problem = package.parse(SUITES[suite], name)
        digits = len(str(len(names) - 1))
        yield {
            "task": f"{suite}-{number:0{digits}}-{'-'.join(short)}",
            "suite": suite,
            "name": name,
            "instruction": " ".join(problem["language_instruction"]) if suite.startswith("pro-") else sentence(name),
            **_scene_facts(problem, package.stored_states(SUITES[suite], name)),
        }


def _scene(match: re.Match[str]) -> str:
    return f"{match[1].replace('_', '').lower()}{match[2]}_"


def _shared(names: Sequence[Sequence[str]]) -> int:
    """Return the number of words with which all names begin."""
    return next((n for n, words in enumerate(zip(*names, strict=False)) if len(set(words)) > 1), 0)


def _scene_facts(problem: Mapping[str, Any], states: FloatArray) -> dict[str, Any]:
    """Return the layout of the scene, from LIBERO's description of the task and its stored states."""
    arena = problem["problem_name"].removeprefix("libero_").removesuffix("_manipulation")
    free = [name for names in problem["objects"].values() for name in names]
    surfaces = {"table", "kitchen_table", "living_room_table", "study_table", "floor", "coffee_table"}
    fixtures = {name: kind for kind, names in problem["fixtures"].items() for name in names}
    ground = {name for name, kind in fixtures.items() if kind in surfaces}
    objects = [name for name in problem["obj_of_interest"] if name in free]
    stands_on_ground = [
        name
        for relation, name, *where in problem["initial_state"]
        if relation == "on" and where[0] in problem["regions"] and problem["regions"][where[0]]["target"] in ground
    ]
    predicates = problem["goal_state"]
    single = len(predicates) == 1 and predicates[0][0] in ("on", "in") and predicates[0][1] in free
    places = {name: states[:, FREE + 7 * number :][:, :2] for number, name in enumerate(free)}
    return {
        "arena": arena,
        "fixtures": sorted(fixtures.keys() - ground),
        "objects": objects,
        "on_ground": [
            name for name in objects if name in stands_on_ground and (np.ptp(places[name], axis=0) > SAME).all()
        ],
        "goal": predicates[0] if single else [],
    }


def written(entries: Sequence[Mapping[str, Any]]) -> str:
    """Format the file, with one task on each line."""
    return "[\n" + ",\n".join(json.dumps(entry) for entry in entries) + "\n]\n"


if __name__ == "__main__":
    Path(__file__).with_name("tasks.json").write_text(written(survey()), encoding="utf-8")
