"""How timing is written, and what it says of answer times."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from robogauntlet.orchestrator.registry import load_registry
from robogauntlet.suites.axes import AXES, LATENCY
from robogauntlet.suites.checks import check_names
from robogauntlet.suites.episode import Condition, Protocol
from robogauntlet.suites.loading import SuiteError, load_suite
from robogauntlet.suites.timing import Timing, TimingMode, read_timing


def loaded(text):
    return load_suite(Path("x.yaml"), load_registry(), text)


SUITE = "name: x\npolicies: [zero]\ntasks: [null/Reach]\nseeds: {count: 1}\n"


@pytest.mark.parametrize(
    ("stated", "found"),
    [
        ("80ms", Timing(TimingMode.HOLD, 80)),
        ("continue:80 ms", Timing(TimingMode.CONTINUE, 80)),
        ("blend:80-140ms", Timing(TimingMode.BLEND, 80, 140)),
        ({"latency_ms": 12.5}, Timing(TimingMode.HOLD, 12.5)),
        ({"mode": "blend", "latency_ms": {"median": 80, "p95": 140}}, Timing(TimingMode.BLEND, 80, 140)),
        ("waits", None),
        ("continue:0ms", None),
        ({"mode": "waits"}, None),
        (None, None),
    ],
)
def test_a_timing_is_read_from_text_and_mapping_and_written_as_text(stated, found):
    assert read_timing(stated) == found
    assert read_timing(None if found is None else str(found)) == found


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        ("80", "expected waits, 80ms, 80-140ms"),
        ("faster:80ms", "mode: expected hold, continue, blend, or waits without a latency; got 'faster'"),
        ("waits:80ms", "got 'waits'"),
        ("99999ms", "expected a latency above 0 and up to 60000 ms, got 99999"),
        ("80-70ms", "expected a 95th percentile above the median of 80 ms, got 70"),
        (80, "expected waits, 80ms"),
        ({"mode": "hold"}, r"latency_ms: expected a number, or \{median: 80, p95: 140\}; got None"),
        ({"latency_ms": {"median": 80}}, "latency_ms: expected a number"),
        ({"latency_ms": True}, "latency_ms: expected a number"),
        ({"latency_ms": float("nan")}, "expected a latency above 0"),
        ({"latency_ms": 80, "p95": 90}, "expected waits, 80ms"),
    ],
)
def test_what_is_no_timing_is_refused_with_what_was_expected(stated, message):
    with pytest.raises(ValueError, match=message):
        read_timing(stated)


def test_a_latency_of_the_command_line_that_is_none_is_one_line(run_command):
    refused = run_command("plan", "smoke", "--latency", "soon").refusal
    assert refused.startswith("--latency: expected waits, 80ms, 80-140ms (median and 95th percentile)")
    assert refused.endswith("got 'soon'")


def test_a_suite_says_where_its_timing_is_wrong():
    with pytest.raises(SuiteError, match=r"timing: .*expected waits, 80ms"):
        loaded(SUITE + "timing: soon\n")


def test_a_suite_with_another_mode_than_that_of_its_axis_is_refused():
    suite = loaded(SUITE + "timing: continue:80ms\nconditions: [clean, latency-continue@1]\n")
    assert not check_names(suite, load_registry())
    with pytest.raises(SuiteError, match="expected blend, as the axis 'latency-blend' has it, got continue"):
        loaded(SUITE + "timing: continue:80ms\nconditions: [clean, latency-blend@1]\n")


def test_a_simulation_that_waits_leaves_ids_as_they_were_and_a_latency_changes_them():
    suite = loaded(SUITE)
    slow, zero = (loaded(SUITE + f"timing: {timing}\n") for timing in ("continue:80ms", "continue:0ms"))
    hashes = [one.content_hash({"zero": "d"}, load_registry()) for one in (suite, zero, slow)]
    assert hashes[0] == hashes[1] != hashes[2]
    assert yaml.safe_load(slow.model_dump_json())["timing"] == "continue:80ms"
    assert "timing" not in Protocol(40).described()


def test_random_answer_times_have_the_median_and_the_percentile():
    timing = Timing(TimingMode.HOLD, 80, 140)
    draws = [timing.latency_ms(one) for one in np.random.default_rng(0).standard_normal(20_000)]
    assert np.percentile(draws, [50, 95]) == pytest.approx([80, 140], rel=0.02)


def test_every_mode_is_an_axis_in_the_same_milliseconds():
    assert sorted(LATENCY.values()) == sorted(TimingMode)
    assert {AXES[name].levels for name in LATENCY} == {(50.0, 100.0, 200.0, 400.0, 800.0)}
    assert str(Condition("latency", 3)) == "latency@3"
