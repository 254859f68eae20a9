"""`robogauntlet run --latency measured`: answers are measured once, then modelled and stored."""

import re

import pytest
import yaml

from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.orchestrator.kit.finding import Finding, Level
from robogauntlet.orchestrator.kit.policy import measured_latency
from robogauntlet.orchestrator.kit.policy.check import Probe
from robogauntlet.results.api import open_run
from robogauntlet.support.errors import BadInput

PROBE = Probe("mine", PolicySource("zero"), "null/Reach")
SLOW = """
import time
import numpy as np

def act(images, proprioception, instruction):
    time.sleep(0.03)
    return np.zeros((8, 7))
"""


@pytest.mark.ray
@pytest.mark.usefixtures("ray_here")
def test_answers_are_measured_once_and_the_numbers_are_the_runs(run_command, tmp_path):
    (tmp_path / "slow.py").write_text(SLOW)
    done = run_command(
        *("run", "--policy", "python:slow:act", "--task", "null/Reach", "--seeds", "1", "--out", "run"),
        *("--latency", "continue:measured"),
    )
    (stored,) = open_run(tmp_path / "run").episodes(("timing",))["timing"]
    assert yaml.safe_load((tmp_path / "run/suite.yaml").read_text())["timing"] == stored
    assert int(re.fullmatch(r"continue:(\d+)(-\d+)?ms", stored)[1]) >= 30
    assert f"played as --latency {stored}" in done.out
    again = run_command("run", "--policy", "zero", "--task", "null/Reach", "--out", "run", "--latency", "measured")
    assert "continue it: robogauntlet resume run" in again.refusal


@pytest.mark.parametrize(
    ("median", "p95", "played"),
    [(80.4, 139.6, "hold:80-140ms"), (80.4, 80.45, "hold:80ms"), (0.4, 30.0, None)],
)
def test_times_are_in_whole_milliseconds_and_none_below_half_a_one(monkeypatch, median, p95, played):
    found = Finding("latency", Level.NOTE, "", {"median_ms": median, "p95_ms": p95})
    monkeypatch.setattr(measured_latency, "check_policy", lambda probe: iter([found]))
    timing, line = measured_latency.measured_timing("measured", PROBE)
    assert (None if timing is None else str(timing)) == played
    assert (played or "the simulation waits") in line


def test_a_policy_without_answers_is_one_line_with_what_was_found(monkeypatch):
    found = Finding("answer", Level.FAILED, "expected finite actions, got nan")
    monkeypatch.setattr(measured_latency, "check_policy", lambda probe: iter([found]))
    with pytest.raises(BadInput, match="a policy that answers in null/Reach, got no answer times; expected finite"):
        measured_latency.measured_timing("measured", PROBE)


def test_a_plan_takes_a_time_and_says_where_answers_are_measured(run_command):
    refusal = run_command("plan", "smoke", "--latency", "hold:measured").refusal
    assert "--latency: expected a time, got 'hold:measured': answers are measured by robogauntlet run" in refusal


@pytest.mark.parametrize(
    ("policies", "latency", "said"),
    [
        (["zero", "random"], "measured", "expected one policy, whose answers are measured; got 2 policies"),
        (["zero"], "fast:measured", "expected hold, continue, blend before :measured, got 'fast'"),
    ],
)
def test_what_cannot_be_measured_is_refused_before_anything_is_played(run_command, tmp_path, policies, latency, said):
    named = [word for name in policies for word in ("--policy", name)]
    assert said in run_command("run", *named, "--task", "null/Reach", "--out", "run", "--latency", latency).refusal
    assert not (tmp_path / "run").exists()
