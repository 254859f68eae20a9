"""Progress displays: live on a terminal, periodic lines in other output."""

import math
from io import StringIO

import pytest
from rich.console import Console
from rich.text import Text

from robogauntlet.orchestrator.live_display import PLAIN_EVERY_S, Display
from robogauntlet.orchestrator.runs.observer import RECORDING, Recording
from robogauntlet.orchestrator.runs.plan import make_plan
from robogauntlet.orchestrator.runs.progress_display import ProgressDisplay, RecordingProgress
from robogauntlet.results.store.history_records import Counts
from tests.orchestrator.runs.playing import SUITE, state_of
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
        for done, clock[0] in enumerate((10.0, 20.0, 59.0), 1):
            progress.show(done)
    assert output.getvalue().splitlines() == [
        "recording: 1/10  stops in 50 s",
        "recording: 2/10  stops in 40 s",
        "recording: 3/10",
    ]


def test_a_recording_that_has_time_for_all_shows_the_time_left():
    output, clock = StringIO(), [0.0]
    with RecordingProgress(Console(file=output, width=80), 5, now=lambda: clock[0]) as progress:
        clock[0] = 10.0
        progress.show(1)
    assert output.getvalue().splitlines() == ["recording: 1/5  40 s left"]


def test_a_verbose_display_has_a_line_for_each_episode(suite_file):
    output = StringIO()
    plan = make_plan(suite_file(SUITE))
    ProgressDisplay(Console(file=output, width=120), verbose=True).on_rows(
        [row(plan.cells[0], 3, steps=12, wall_s=0.5), row(plan.cells[0], 4, "error", error="no room", wall_s=2.0)]
    )
    cell = plan.cells[0]
    first, second = output.getvalue().splitlines()[:2]
    assert first == f"{cell.task}, {cell.policy}, seed 3: success in 12 steps, 0.50 s"
    assert second.endswith("2.00 s: no room")


@pytest.mark.parametrize(("policies", "has_rate"), [("[oracle]", True), ("[oracle, random]", False)])
def test_only_a_single_policy_has_a_rate(suite_file, policies, has_rate):
    output = StringIO()
    plan = make_plan(suite_file(SUITE.replace("[oracle, random]", policies)))
    display = ProgressDisplay(Console(file=output, width=100))
    run = state_of(plan, {(plan.cells[0].policy_digest, "null/Reach", "clean", 0): Counts(0, 9, 1)})
    display.on_tick(run)
    display.on_numbers(run)
    assert ("success 90 %" in output.getvalue()) is has_rate
    assert "null: 10/" in output.getvalue()


def test_videos_are_shown_by_a_bar_of_their_own_which_ends_with_them(suite_file):
    output, clock = StringIO(), [0.0]
    display = ProgressDisplay(Console(file=output, width=80), now=lambda: clock[0])
    run = state_of(make_plan(suite_file(SUITE)))
    run.phase, run.recording = RECORDING, Recording(5, math.inf)
    display.on_tick(run)
    clock[0], run.recording.done = 10.0, 1
    display.on_tick(run)
    run.recording = None
    display.on_tick(run)
    display.on_end(run)
    assert output.getvalue().splitlines() == ["recording: 1/5  40 s left"]


def test_a_terminal_is_given_back_when_a_run_breaks(suite_file):
    output = StringIO()
    display = ProgressDisplay(Console(file=output, force_terminal=True, width=80))
    run = state_of(make_plan(suite_file(SUITE)))
    display.on_tick(run)
    display.close()
    run.phase, run.recording = RECORDING, Recording(5, math.inf)
    display.on_tick(run)
    display.close()
    assert output.getvalue().count("\x1b[?25l") == output.getvalue().count("\x1b[?25h") == 2  # the cursor
