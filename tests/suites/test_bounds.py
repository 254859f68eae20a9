"""Suites that expand without end, or have mistakes without end, are refused at once in a few lines."""

import time

import pytest

from robogauntlet.suites.checks import MOST_MISTAKES
from robogauntlet.suites.loading import SuiteError, load_suite
from robogauntlet.suites.ranges import MAX_CELLS, MAX_PATTERNS
from robogauntlet.suites.registry import KnownPolicy, KnownTask, Registry

TASKS = {f"libero-plus/put-the-bowl-on-the-plate-{i}": KnownTask(300) for i in range(10_000)}
NAMES = Registry(
    tasks=TASKS,
    policies={"oracle": KnownPolicy(tasks=frozenset()), "zero": KnownPolicy()},
    axes={"light": 5, "blind": 5},
)
AXES = "[clean, {axis: light, severities: [1, 2, 3]}, {axis: blind, severities: [1, 2, 3]}]"
MORE = f"more than {MOST_MISTAKES} mistakes, of which these are shown:"
SOUND = {"name": "s", "policies": "[zero]", "tasks": "['libero-plus/*']", "seeds": "{count: 1}"}
HOSTILE = {
    "a pattern 2,000 times": (
        {"tasks": str(["*"] * 2000)},
        "duplicate pattern '*', expected it once, got it 2000 times",
    ),
    "many patterns": (
        {"tasks": str([f"libero-plus/*{i}" for i in range(9999)])},
        f"expected at most {MAX_PATTERNS} patterns of tasks, got 9999; use wider ones",
    ),
    "unknown tasks": ({"tasks": str([f"libero-plus/put-the-plate-on-bowl-{i}" for i in range(3000)])}, MORE),
    "tasks that a policy cannot play": ({"policies": "[oracle]"}, MORE),
    "unknown policies": ({"policies": str([f"zeroo{i}" for i in range(900)]), "tasks": str([*TASKS][:1])}, MORE),
    "unknown conditions": ({"conditions": str([f"lights{i}@2" for i in range(99)]), "tasks": str([*TASKS][:9])}, None),
    "unknown keys": ({f"key{i}": "1" for i in range(20_000)}, MORE),
    "keys that occur twice": ({"name": "s\n" + "name: s\n" * 10_000}, MORE),
    "cells": (
        {"policies": str([{"name": f"p{i}", "kind": "zero"} for i in range(20)]).replace("'", ""), "conditions": AXES},
        f"expected at most {MAX_CELLS:,} combinations of task, policy and condition, got 10,000 x 20 x 7 = 1,400,000",
    ),
    "episodes": (
        {"seeds": "{count: 10000000}"},
        "expected at most 1,000,000,000 episodes, got 10,000 combinations of task, policy and condition x 10,000,000",
    ),
    "episodes of an adaptive suite": (
        {"adaptive": "{max_seeds: 10000000}"},
        "expected at most 1,000,000,000 episodes, got 10,000 combinations of task, policy and condition x 10,000,000",
    ),
    "robots": ({"robots": str([f"arm{i}" for i in range(9999)])}, "got 99,990,000 x 1 x 1"),
    "names twice": (
        {"compare": f"{{baseline: zero, others: [{'zero,' * 9999}]}}", "tasks": str([*TASKS][:1])},
        "compare names policy 'zero' twice",
    ),
}


def load(tmp_path, keys):
    (path := tmp_path / "suite.yaml").write_text("".join(f"{k}: {v}\n" for k, v in {**SOUND, **keys}.items()))
    return load_suite(path, NAMES)


@pytest.mark.parametrize(("keys", "first"), HOSTILE.values(), ids=HOSTILE)
def test_a_suite_without_bounds_is_refused_at_once(tmp_path, keys, first):
    began = time.process_time()
    with pytest.raises(SuiteError) as refused:
        load(tmp_path, keys)
    assert time.process_time() - began < 8
    lines = str(refused.value).splitlines()
    assert len(lines) <= MOST_MISTAKES + 1
    assert first is None or first in lines[0]
    assert sum("did you mean" in line for line in lines) <= 10


def test_a_suite_within_the_bounds_is_read(tmp_path):
    suite = load(tmp_path, {"conditions": AXES, "seeds": "{count: 10000}"})
    assert len(suite.tasks) * len(suite.all_conditions()) == 70_000


def test_hints_are_for_the_first_ten_mistakes(tmp_path):
    with pytest.raises(SuiteError) as refused:
        load(tmp_path, {"tasks": str([f"libero-plus/put-the-plate-on-bowl-{i}" for i in range(20)])})
    assert ["did you mean" in one.message for one in refused.value.problems] == [True] * 10 + [False] * 10
    assert refused.value.problems[-1].message == "unknown task 'libero-plus/put-the-plate-on-bowl-19'"
