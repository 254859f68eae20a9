"""Objects of this process as policies: what they are, and which of them count as the same."""

import numpy as np
import pytest

from robogauntlet.orchestrator.api.served_object import ServedObject
from robogauntlet.policies import catalog
from robogauntlet.policies.contract import PolicyError
from tests.errors import one_line_error

SPEED = 0.01


def still(images, proprioception, instruction):
    return np.zeros((8, 7))


def still_again(images, proprioception, instruction):
    return np.zeros((8, 7))


def fast(images, proprioception, instruction):
    return np.full((8, 7), SPEED)


def fast_within(images, proprioception, instruction):
    return (lambda: np.full((8, 7), SPEED))()


def with_default(images, proprioception, instruction, speed=SPEED):
    return np.full((8, 7), speed)


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
        lambda images, proprioception, instruction: np.zeros((8, 7)),
    ],
)
def test_what_may_depend_on_more_than_its_source_is_new_at_each_call_unless_identified(target):
    assert digest(target) != digest(target)
    assert digest(target, identity="a") == digest(target, identity="a") != digest(target, identity="b")


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
        (None, r"policy 'wrong': expected an action chunk"),
        ("up", r"policy 'wrong': expected an action chunk"),
    ],
)
def test_an_answer_of_a_wrong_shape_is_one_line(answer, match):
    served = ServedObject(lambda images, proprioception, instruction: answer, name="wrong")
    with one_line_error(PolicyError, match):
        served.check_answer(("wrist",), 16, "reach")


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_function_may_need_something_to_see():
    def act(images, proprioception, instruction):
        (rows,) = np.nonzero(images["wrist"].any(axis=(1, 2)))
        return np.full((1, 7), rows.mean() if instruction == "reach" else rows[0])

    for instruction in ("reach", "push"):
        ServedObject(act).check_answer(("wrist",), 16, instruction)
