"""Progress displays: live on a terminal, periodic lines in other output."""

from io import StringIO

import pytest
from rich.console import Console
from rich.text import Text

from robogauntlet.orchestrator.live_display import PLAIN_EVERY_S, Display
from robogauntlet.orchestrator.runs.plan import make_plan
from robogauntlet.orchestrator.runs.progress import Progress, RecordingProgress
from tests.orchestrator.runs.playing import SUITE
from tests.results.synthetic import row


def shown(terminal, *, transient=False):
    output, clock = StringIO(), [0.0]
    console = Console(file=output, force_terminal=terminal, width=80)
    with Display(console, transient=transient, now=lambda: clock[0]) as display:
        for step in range(5):
            clock[0] = step * PLAIN_EVERY_S / 2
            display.draw(lambda step=step: Text(f"picture {step}"), lambda step=step: [f"line {step}"])
        display.draw(lambda: Text("picture 5"), lambda: ["line 5"], at_once=True)
    return output.getvalue()


def test_without_a_terminal_lines_are_printed_periodically_and_on_request():
    assert shown(terminal=False).splitlines() == ["line 2", "line 4", "line 5"]


def test_on_a_terminal_the_last_display_remains():
    output = shown(terminal=True)
    assert "picture 5" in output
    assert "line" not in output


def test_a_transient_display_is_removed():
    assert shown(terminal=True, transient=True).rstrip().endswith("\x1b[2K")


def test_a_recording_shows_the_time_until_all_is_recorded_or_says_when_it_stops_before():
    output, clock = StringIO(), [0.0]
    console = Console(file=output, width=80)
    with RecordingProgress(console, 10, end=60.0, now=lambda: clock[0]) as progress:
        for clock[0] in (10.0, 20.0, 59.0):
            progress.advance()
    assert output.getvalue().splitlines() == [
        "recording: 1/10  stops in 50 s",
        "recording: 2/10  stops in 40 s",
        "recording: 3/10",
    ]


def test_a_recording_that_has_time_for_all_shows_the_time_left():
    output, clock = StringIO(), [0.0]
    with RecordingProgress(Console(file=output, width=80), 5, now=lambda: clock[0]) as progress:
        clock[0] = 10.0
        progress.advance()
    assert output.getvalue().splitlines() == ["recording: 1/5  40 s left"]


def test_a_verbose_display_has_a_line_for_each_episode(suite_file):
    output = StringIO()
    plan = make_plan(suite_file(SUITE))
    with Progress(Console(file=output, width=120), verbose=True) as progress:
        progress.begin(plan, {})
        progress.on_results(
            [row(plan.cells[0], 3, steps=12, wall_s=0.5), row(plan.cells[0], 4, "error", error="no room", wall_s=2.0)]
        )
    cell = plan.cells[0]
    first, second = output.getvalue().splitlines()[:2]
    assert first == f"{cell.task}, {cell.policy}, seed 3: success in 12 steps, 0.50 s"
    assert second.endswith("2.00 s: no room")


@pytest.mark.parametrize(("policies", "has_rate"), [("[oracle]", True), ("[oracle, random]", False)])
def test_only_a_single_policy_has_a_rate(suite_file, policies, has_rate):
    output = StringIO()
    with Progress(Console(file=output, width=100)) as progress:
        plan = make_plan(suite_file(SUITE.replace("[oracle, random]", policies)))
        progress.begin(plan, {("null", "success"): 9, ("null", "failure"): 1})
    assert ("success 90 %" in output.getvalue()) is has_rate
    assert "null: 10/" in output.getvalue()
