"""Expressions in mapping files reach numbers and arrays, run no code, and stay small whatever they say."""

import time
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robogauntlet.adapters.gymnasium.expressions import KINDS, check_expression, undeclared, value_of

CALLED = []


class World:
    """An environment every method of which leaves a mark."""

    goal = np.array([1.0, 2.0, 3.0])
    name = "world"
    numbers = ()

    def make(self, *_):
        CALLED.append("make")
        return 1.0

    def __call__(self, *_):
        CALLED.append("call")
        return self

    @property
    def spec(self):
        return self


NAMES = {
    "observation": {"goal": np.arange(5), "image": np.zeros((64, 64, 3), np.uint8)},
    "info": {"is_success": np.True_, "parts": [1.0, {"deep": 2}], "text": "done", "world": World()},
    "reward": 0.5,
    "terminated": False,
    "unwrapped": World(),
}
REFUSED = [
    'unwrapped.spec.from_json(\'{"entry_point": "os:system"}\').make()',
    "'{0.__class__.__init__.__globals__}'.format(unwrapped)",
    "unwrapped.make()",
    "unwrapped.spec.make()",
    "unwrapped()",
    "unwrapped",
    "info['world'].make()",
    "info['world']()",
    "info['world'].goal",
    "observation.tofile('/tmp/x')",
    "unwrapped.__class__",
    "unwrapped.data.bind('x').xpos",
    "unwrapped.data.site('x').__class__",
    "unwrapped.data.site('x', 'y').xpos",
    "unwrapped.data.site(reward).xpos",
    "__import__('os').system('ls')",
    "abs.__self__",
    "abs(reward, reward)",
    "abs(x=reward)",
    "max(*observation)",
    "(lambda: 1)()",
    "[reward for x in observation]",
    "f'{reward}'",
    "reward if terminated else 1",
    "9**9**9",
    "[0] * 10**9",
    "[0] * 1000000000",
    "'a' * 1000000000",
    "1 << 1000000",
    "(reward := 1)",
    "1j",
    "b'x'",
    "None",
    "...",
    "-" * 500 + "1",
    "(" * 150 + "1" + ")" * 150 + "[0]" * 100,
    "9" * 2_000,
    "reward\0",
    "(reward\n+ eval)",
    "\ud800",
]


@pytest.mark.parametrize("text", REFUSED, ids=range(len(REFUSED)))
def test_what_is_no_reading_of_numbers_is_refused_in_one_line_before_anything_is_made(text):
    CALLED.clear()
    with pytest.raises(ValueError, match=r"expect|expression|unknown") as error:
        check_expression(text)
    assert "\n" not in str(error.value)
    assert not CALLED


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("reward >= 0.25", True),
        ("0.25 <= reward < 0.5", False),
        ("not terminated and reward > 0 or terminated", True),
        ('observation["goal"][1:3] * 2 - 1', [1.0, 3.0]),
        ('observation["goal"][-1] / 2', 2.0),
        ('observation["image"][0, 1:3, 2]', [0.0, 0.0]),
        ('info["parts"][1]["deep"] + 1', 3.0),
        ('norm(observation["goal"][0:3] - unwrapped.goal)', 3**0.5),
        ("max(unwrapped.goal) == 3", True),
        ("unwrapped.spec.spec.goal[0]", 1.0),
    ],
)
def test_an_expression_reads_items_declared_attributes_and_calculates(text, value):
    assert np.array_equal(value_of(check_expression(text), NAMES, ("goal", "spec.spec.goal")), value)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ('info["text"]', "expected a number or an array"),
        ("observation", "found dict"),
        ('observation["goal"]["x"]', "has no item 'x'"),
        ('info["world"][0]', "a World has no item 0"),
        ("reward[0]", "too many indices|not subscriptable|no item"),
        ('observation["goal"][0.5]', "expected a whole number between brackets, got 0.5"),
        ("unwrapped.name", "found str"),
        ("unwrapped.make", "'make' of 'make' is no attribute with numbers"),
        ("unwrapped.goal", "'goal' is not declared; add it to `reads`"),
        ("unwrapped.data.qpos", "no 'data' there"),
        ('observation["image"][:, :, 0:1] + observation["image"][0:1, 0:1]', ""),
    ],
)
def test_what_is_no_number_is_refused_in_one_line(text, line):
    if not line:
        assert value_of(text, NAMES).shape == (64, 64, 3)
        return
    with pytest.raises(ValueError, match=line) as error:
        value_of(text, NAMES, ("name", "make"))
    assert "\n" not in str(error.value)


def test_a_result_that_would_fill_the_memory_is_refused():
    wide = {**NAMES, "observation": np.zeros((1, 100_000)), "info": np.zeros((100_000, 1))}
    with pytest.raises(ValueError, match="a result of at most 1000000 numbers"):
        value_of("observation + info", wide)


def test_an_attribute_that_is_not_declared_is_named():
    assert undeclared("unwrapped.data.qpos[0] + unwrapped.robot.arm.angle", ("robot",)) == "robot.arm.angle"
    assert undeclared(f'unwrapped.data.{KINDS[0]}("x").ctrl > unwrapped.goal[0]', ("goal",)) is None


WORDS = st.sampled_from(
    [
        *(
            "observation",
            "info",
            "reward",
            "terminated",
            "unwrapped",
            "abs",
            "norm",
            "make",
            "spec",
            "goal",
            "from_json",
        ),
        *("world", "data", "site", "__class__", "__call__", "eval", "open", "format", "'goal'", "'world'", "'text'"),
        *("0", "1", "-1", "9", "1e308", "10000000000", "True", "None", "'%999999999d'"),
    ]
)
EXPRESSIONS = st.recursive(
    WORDS,
    lambda inner: st.one_of(
        st.tuples(
            inner, st.sampled_from(["+", "-", "*", "/", "**", "//", "%", "<<", "@", "<", "==", " and ", " or "]), inner
        ),
        st.tuples(inner, st.just("."), WORDS),
        st.tuples(inner, st.just("("), inner, st.just(")")),
        st.tuples(inner, st.just("()")),
        st.tuples(inner, st.just("["), inner, st.just("]")),
        st.tuples(inner, st.just("["), inner, st.just(":"), inner, st.just("]")),
        st.tuples(st.sampled_from(["-", "not ", "+", "~", "*"]), inner),
        st.tuples(st.just("("), inner, st.just(","), inner, st.just(")")),
        st.tuples(st.just("["), inner, st.just("]")),
    ).map("".join),
    max_leaves=12,
)


@settings(max_examples=1_500, deadline=None)
@given(st.one_of(EXPRESSIONS, st.text(max_size=60)))
def test_whatever_is_written_calls_nothing_and_stays_small(text):
    CALLED.clear()
    started = time.monotonic()
    tracemalloc.start()
    try:
        value = np.asarray(value_of(check_expression(text), NAMES, ("goal", "make", "spec", "spec.goal", "name")))
        assert value.dtype.kind in "bf"
        assert value.size <= 1_000_000
    except ValueError:
        pass
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert not CALLED
    assert peak < 50e6
    assert time.monotonic() - started < 10
