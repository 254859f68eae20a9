"""Objects of this process as policies: what they are, and which of them count as the same."""

import importlib
import linecache
import sys
import threading
from dataclasses import replace

import numpy as np
import pytest
import torch

from robogauntlet.adapters.contract import TaskDescription
from robogauntlet.orchestrator.api.served_object import ServedObject
from robogauntlet.orchestrator.inference import first_answer
from robogauntlet.policies import catalog
from robogauntlet.policies.contract import PolicyError
from robogauntlet.suites.episode import View
from tests import processes
from tests.errors import one_line_error

SPEED, PACKAGE = 0.01, "numpy"
WRIST = View(("wrist",), 16)
REACH = TaskDescription("reach", 60)


def still(images, proprioception, instruction):
    return np.zeros((8, 7))


def still_again(images, proprioception, instruction):
    return np.zeros((8, 7))


def fast(images, proprioception, instruction):
    return np.full((8, 7), SPEED)


def of_a_text(images, proprioception, instruction):
    return np.full((8, 7), len(PACKAGE))


def fast_within(images, proprioception, instruction):
    return (lambda: np.full((8, 7), SPEED))()


def with_default(images, proprioception, instruction, speed=SPEED):
    return np.full((8, 7), speed)


def of_an_own_module(images, proprioception, instruction):
    return np.full((8, 7), processes.SPEED)


def that_imports(images, proprioception, instruction):
    from tests import processes

    return np.full((8, 7), processes.SPEED)


def that_reads(images, proprioception, instruction):
    with open("speed.txt") as file:  # noqa: PTH123
        return np.full((8, 7), float(file.read()))


def closure(speed):
    def act(images, proprioception, instruction):
        return np.full((8, 7), speed)

    return act


class Counting:
    def __init__(self):
        self.steps = 0

    def reset(self):
        self.steps = 0

    def __call__(self, images, proprioception, instruction):
        self.steps += 1
        return np.full((8, 7), 0.001 * self.steps)


def digest(target, **options):
    return ServedObject(target, **options).server.served.digest


def test_a_function_that_uses_nothing_else_is_identified_by_its_source():
    assert digest(still) == digest(still)
    assert digest(still) != digest(still_again)


@pytest.mark.parametrize(
    "target",
    [
        *(fast, fast_within, with_default, closure(0.1), Counting(), Counting),
        *(of_a_text, of_an_own_module, that_imports, that_reads),
        lambda images, proprioception, instruction: np.zeros((8, 7)),
    ],
)
def test_what_may_depend_on_more_than_its_source_is_new_at_each_call_unless_identified(target):
    assert digest(target) != digest(target)
    assert digest(target, identity="a") == digest(target, identity="a") != digest(target, identity="b")


def test_a_function_whose_file_has_changed_since_it_was_loaded_is_another(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # Python tells sources by their second and size
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "changing.py").write_text("def act(images, proprioception, instruction):\n    return [[0.0] * 7]\n")
    loaded = importlib.import_module("changing").act
    before = digest(loaded)
    (tmp_path / "changing.py").write_text("def act(images, proprioception, instruction):\n    return [[0.1] * 7]\n")
    sys.modules.pop("changing")
    linecache.clearcache()
    assert before != digest(loaded) != digest(importlib.import_module("changing").act)


def test_other_programs_cannot_ask_it():
    with ServedObject(still) as served:
        options = {**served.entry.options, "token_variable": None, "retries": 0}
        with one_line_error(PolicyError, "token"):
            catalog.digest("openpi", options)


def test_a_class_or_factory_of_any_options_is_not_taken_for_a_function():
    class Open:
        def __init__(self, **options):
            self.options = options

        def __call__(self, images, proprioception, instruction):
            return np.zeros((8, 7))

    ServedObject(Open).check_answer(WRIST, REACH)


def test_it_is_named_after_the_function_or_class():
    assert ServedObject(still).name == "still"
    assert ServedObject(Counting()).name == "Counting"
    assert ServedObject(lambda images, proprioception, instruction: None).name == "lambda"
    assert ServedObject(still, name="mine/v2").name == "mine-v2"


def test_only_an_object_with_reset_plays_one_episode_at_a_time():
    assert ServedObject(Counting()).is_sequential
    for target in (Counting, still, catalog.load("untrained", {})):
        assert not ServedObject(target).is_sequential


def test_the_policy_of_a_run_is_the_served_one():
    with ServedObject(still) as served:
        entry = served.entry
        assert catalog.digest(entry.kind, entry.options) == digest(still)
        assert catalog.spec(entry.kind, entry.options) == served.server.served.policy.spec


@pytest.mark.parametrize(
    ("target", "match"),
    [
        (5, "expected a function of images, proprioception, instruction"),
        (object(), "without __call__"),
        (lambda observation: None, "expected parameters named images, proprioception, instruction"),
        (closure, "expected parameters named images, proprioception, instruction"),
    ],
)
def test_what_is_no_policy_is_one_line(target, match):
    with one_line_error(PolicyError, match):
        ServedObject(target)


@pytest.mark.parametrize(
    ("answer", "match"),
    [
        (np.zeros(7), r"expected an action chunk of shape \(n, 7\) with n >= 1, got \(7,\)"),
        (np.zeros((8, 6)), r"got \(8, 6\)"),
        (np.zeros((0, 7)), r"got \(0, 7\)"),
        (None, r"policy 'wrong': expected an action chunk, shape \(n, 7\); got None: a return is missing"),
        ([["up"] * 7], r"policy 'wrong': expected an action chunk of numbers"),
        ("up", r"policy 'wrong': expected an action chunk"),
        (np.zeros((8, 7), complex), "policy 'wrong': expected an action chunk of numbers.*complex128"),
        (np.zeros((8, 7)).astype(str), "expected an action chunk of numbers.*type is <U32"),
        (np.array([[10**400] * 7], object), "expected an action chunk of numbers.*int too large"),
        ([[10**400] * 7], "expected an action chunk of numbers.*int too large"),
        ([[0.0] * 7, [0.0] * 6], "expected an action chunk of numbers.*inhomogeneous"),
        (torch.zeros(8, 7, requires_grad=True), r"got Tensor: Can't call numpy\(\) on Tensor that requires grad"),
    ],
)
def test_an_answer_of_a_wrong_shape_is_one_line(answer, match):
    served = ServedObject(lambda images, proprioception, instruction: answer, name="wrong")
    with one_line_error(PolicyError, match):
        served.check_answer(WRIST, REACH)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_function_may_need_something_to_see():
    def act(images, proprioception, instruction):
        (rows,) = np.nonzero(images["wrist"].any(axis=(1, 2)))
        return np.full((1, 7), rows.mean() if instruction == "reach" else rows[0])

    for instruction in ("reach", "push"):
        ServedObject(act).check_answer(WRIST, replace(REACH, instruction=instruction))


def test_a_function_that_hangs_is_refused_before_anything_is_started(monkeypatch):
    released = threading.Event()

    def hangs(images, proprioception, instruction):
        released.wait(60)

    monkeypatch.setattr(first_answer, "LIMIT_S", 0.1)
    with one_line_error(PolicyError, r"policy 'hangs': expected its first answer within 0.1 s, got none"):
        ServedObject(hangs).check_answer(WRIST, REACH)
    released.set()


def test_a_process_ends_although_its_policy_hangs(tmp_path):
    script = """
import time
from concurrent.futures import wait
from robogauntlet.orchestrator.inference.daemon_thread import DaemonThread
wait([DaemonThread().submit(time.sleep, 1000)], 0.1)
print("over")
"""
    done = processes.run_process([sys.executable, "-c", script], tmp_path, timeout=60)
    assert (done.returncode, done.stdout) == (0, "over\n")
