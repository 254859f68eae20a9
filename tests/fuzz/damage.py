"""Valid examples with damage: bytes that were flipped, cut, inserted or repeated, and values that were replaced."""

import copy
import os
from datetime import timedelta

import numpy as np
from hypothesis import HealthCheck, given, settings, strategies as st

EXAMPLES = int(os.environ.get("ROBOGAUNTLET_FUZZ_EXAMPLES", "60"))
"""Examples of each parser; `make fuzz` takes a hundred times as many, every night."""
DEADLINE = timedelta(seconds=20)
"""Time of an example, far above what any takes."""
ODD = (
    *(
        None,
        True,
        0,
        1,
        -1,
        2**31,
        2**53,
        2**63,
        10**30,
        0.5,
        1e300,
        float("nan"),
        float("inf"),
        "",
        "x",
        "\0",
        "\x1b[31m",
    ),
    *("a\nb", "\u202e", "٣", "..", "/", "x" * 1_000, "\ud800", [], {}, [[]], {"x": 1}, [None], ["x"] * 50),
)
"""Values that programs forget."""
PIECES = (b"", b"\0", b"\xff", b"\xff" * 8, b"[" * 200, b"{", b"]", b'"', b"-", b"9" * 30, b"\n", b": ", b"&a", b"*a")


def fuzzed(strategy, share=1.0):
    """Decorate a test of one argument, which is drawn from a strategy `EXAMPLES` times, or a share of these."""
    settled = settings(
        max_examples=max(1, round(EXAMPLES * share)),
        deadline=DEADLINE,
        suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow, HealthCheck.data_too_large],
    )
    return lambda test: settled(given(damaged=strategy)(test))


@st.composite
def damaged_bytes(draw, example):
    """Bytes of an example after a few changes, or none."""
    content = bytearray(example)
    for _ in range(draw(st.integers(0, 4))):
        place = draw(st.integers(0, len(content)))
        length = draw(st.integers(0, 40))
        match draw(st.integers(0, 4)):
            case 0 if content:
                content[min(place, len(content) - 1)] ^= 1 << draw(st.integers(0, 7))
            case 1:
                del content[place : place + length]
            case 2:
                content[place:place] = draw(st.sampled_from(PIECES) | st.binary(max_size=16))
            case 3:
                content[place:place] = content[place : place + length]
            case _:
                del content[place:]
    return bytes(content)


@st.composite
def damaged_value(draw, example):
    """An example of lists, mappings and numbers, in which a few values are replaced, removed or added."""
    value = copy.deepcopy(example)
    for _ in range(draw(st.integers(1, 3))):
        inner = value
        while isinstance(inner, dict | list) and len(inner):
            key = draw(st.sampled_from(sorted(inner, key=str) if isinstance(inner, dict) else range(len(inner))))
            if not isinstance(inner[key], dict | list) or not len(inner[key]) or draw(st.booleans()):
                _change(draw, inner, key)
                break
            inner = inner[key]
    return value


def _change(draw, inner, key):
    match draw(st.integers(0, 5)):
        case 0:
            del inner[key]
        case 1 if isinstance(inner, dict):
            inner[draw(st.sampled_from(["x", "", "a\nb", "x" * 300]))] = copy.deepcopy(draw(st.sampled_from(ODD)))
        case 2 if isinstance(inner[key], int | float | np.number) and not isinstance(inner[key], bool):
            inner[key] = draw(st.integers(-(2**70), 2**70) | st.floats())
        case 3:
            inner[key] = [copy.deepcopy(inner[key])]
        case _:
            inner[key] = copy.deepcopy(draw(st.sampled_from(ODD)))


def in_one_line(error, longest=2_000):
    """Assert that the message of an error is one line of moderate length."""
    text = str(error)
    assert 0 < len(text) <= longest, len(text)
    assert len(text.splitlines()) == 1, text
