"""The shipped smoke suite of perturbations over three simulators: everything delivered, nothing else changed."""

import io
import json
import math

import pytest
from rich.console import Console

from robogauntlet.orchestrator.runs.plan import find_suite, make_plan
from robogauntlet.orchestrator.runs.progress import Progress
from robogauntlet.orchestrator.runs.run import RunOptions, run_plan
from robogauntlet.results.record import Status
from robogauntlet.results.report import ReportPaths
from robogauntlet.results.store.episode_store import Store
from robogauntlet.suites.axes import AXES
from robogauntlet.suites.episode import CONTROLS

pytestmark = [pytest.mark.ray, pytest.mark.simulator, pytest.mark.slow, pytest.mark.usefixtures("ray_here")]
SEEN = ("camera-orbit", "illuminance", "distractors", "object-position", "robot-start", "noise")
"""Axes of the suite that change the first look."""


@pytest.fixture(scope="module")
def played(tmp_path_factory, ray_here):
    folder = tmp_path_factory.mktemp("runs") / "smoke"
    shown = Progress(Console(file=io.StringIO(), force_terminal=False))
    return run_plan(make_plan(find_suite("robustness-smoke")), folder, RunOptions(), shown)


@pytest.fixture(scope="module")
def rows(played):
    store = Store.open_file(played.folder / "episodes.sqlite", played.document.run_id)
    found = list(store.results())
    store.close()
    return found


def test_no_episode_is_an_error(rows):
    assert {row.error for row in rows if row.status == Status.ERROR} == set()
    assert len(rows) == 156


def test_films_come_out_as_the_rows_and_every_condition_is_pictured(played, rows):
    assert played.warnings == []
    pictured = {path.stem.partition("@")[2] for path in (played.folder / "media/looks").glob("*.png")}
    conditions = {(row.axis, row.severity) for row in rows if row.axis not in CONTROLS}
    assert pictured == {f"{axis}@{severity}" for axis, severity in conditions}
    page = (played.folder / "report.html").read_text()
    assert page.count(": clean" + chr(34)) == 3 * len(SEEN)
    assert "Recorded failures of episodes that succeed under the clean condition" in page


def test_every_level_is_delivered_where_a_policy_looks_and_where_actions_are_perturbed(rows):
    for row in rows:
        if row.axis != "clean" and (row.policy == "experts" or row.delivered is not None):
            axis = AXES[row.axis]
            assert math.isclose(row.delivered, axis.value(row.severity), abs_tol=max(axis.tolerance, 1e-6))


def test_all_start_from_the_clean_world_and_the_report_says_so(played):
    found = json.loads(ReportPaths.in_folder(played.folder).summary.read_text())["robustness"]
    assert found["start_states"] == {"compared": 120, "differing": 0}
    assert found["oracle_gate"] == "oracle"
    assert {row["control"] for row in found["controls"]} == {"blind", "wrong-goal"}
    assert {row["axis"] for row in found["gate_rows"]} <= {"action-delay", "object-position", "robot-start"}


def test_clean_episodes_played_twice_end_alike_to_the_bit_in_each_simulator(played):
    found = json.loads(ReportPaths.in_folder(played.folder).summary.read_text())["robustness"]["repeats"]
    assert [(row["simulator"], row["episodes"], row["identical"]) for row in found] == [
        (simulator, 4, 4) for simulator in ("maniskill", "pybullet", "robosuite")
    ]
