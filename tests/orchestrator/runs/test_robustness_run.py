"""Half of the shipped smoke suite of perturbations: all levels delivered, nothing else changed."""

import json
import math

import pytest

from robogauntlet.orchestrator.registry import find_suite
from robogauntlet.orchestrator.replay.media_selection import shared_by
from robogauntlet.results.record import Status
from robogauntlet.results.report import ReportPaths
from robogauntlet.suites.axes import AXES
from robogauntlet.suites.episode import CONTROLS
from robogauntlet.suites.selection import SuiteSelection
from tests.orchestrator.runs.playing import play, rows_of

pytestmark = [
    *(pytest.mark.ray, pytest.mark.simulator, pytest.mark.slow, pytest.mark.nightly),
    pytest.mark.usefixtures("ray_here"),
]
TASKS = ("maniskill/PushCube-v1", "pybullet/PandaReach-v3", "robosuite/Lift")
SEEN = ("camera-orbit", "illuminance", "object-position")
"""Axes of the suite that change the first observation."""
LEFT_OUT = """  - {axis: distractors, severities: [4]}
  - {axis: robot-start, severities: [2]}
  - {axis: noise, severities: [4]}
  - {axis: instruction, severities: [2]}
"""
"""Conditions of the suite that are played as the others are; `perturbations/test_real.py` sees each delivered."""


@pytest.fixture(scope="module", params=[TASKS], ids=len)
def tasks(request):
    return request.param


@pytest.fixture(scope="module")
def played(tasks, tmp_path_factory, ray_here):
    folder = tmp_path_factory.mktemp("runs")
    text = find_suite("robustness-smoke").read_text()
    for line in LEFT_OUT.splitlines(keepends=True):
        assert line in text
        text = text.replace(line, "")
    (suite := folder / "smoke.yaml").write_text(text.replace("[2, 4]", "[4]") + "workers: 1\n")
    return play(suite, folder / "smoke", part=SuiteSelection(tasks=tasks, seeds=1), media=True)


@pytest.fixture(scope="module")
def rows(played):
    return rows_of(played.folder)


def test_no_episode_is_an_error(tasks, rows):
    assert {row.error for row in rows if row.status == Status.ERROR} == set()
    assert len(rows) == 16 * len(tasks)


def test_replays_for_videos_end_like_the_rows_and_every_condition_has_a_snapshot(tasks, played, rows):
    assert played.warnings == []
    assert len(list((played.folder / "media/pictures").glob("*.png"))) == len(tasks)
    pictured = {path.stem.partition("@")[2] for path in (played.folder / "media/snapshots").glob("*.png")}
    conditions = {(row.axis, row.severity) for row in rows if row.axis not in CONTROLS}
    assert pictured == {f"{axis}@{severity}" for axis, severity in conditions}
    page = (played.folder / "report.html").read_text()
    assert page.count(": clean" + chr(34)) == len(tasks) * len(SEEN)
    videos = {path.stem for path in (played.folder / "media/videos").glob("*.mp4")}
    shown = {shared_by(row) for row in rows if row.episode_id in videos}
    recorded = {(row.task, row.policy, row.status) for row in rows if shared_by(row) in shown}
    assert recorded == {(row.task, row.policy, row.status) for row in rows}
    assert page.count("data:video/mp4") == len(videos)
    assert "Recorded failures of episodes that succeed under the clean condition" in page


def test_every_level_is_delivered_if_the_policy_observes_or_actions_are_perturbed(rows):
    for row in rows:
        on_scale = row.axis not in ("clean", "instruction", *CONTROLS)
        if on_scale and (row.policy == "experts" or row.delivered is not None):
            axis = AXES[row.axis]
            assert math.isclose(row.delivered, axis.value(row.severity), abs_tol=max(axis.tolerance, 1e-6))


def test_all_episodes_start_from_the_clean_state_and_the_report_says_so(tasks, played):
    robustness = json.loads(ReportPaths.in_folder(played.folder).summary.read_text())["robustness"]
    assert robustness["start_states"] == {"compared": 12 * len(tasks), "differing": 0}
    assert robustness["oracle_gate"] == "oracle"
    assert {row["control"] for row in robustness["controls"]} == {"blind", "wrong-goal"}
    assert {row["axis"] for row in robustness["gate_rows"]} <= {"action-delay", "object-position", "robot-start"}


def test_repeated_clean_episodes_are_bit_identical_in_each_simulator(tasks, played):
    robustness = json.loads(ReportPaths.in_folder(played.folder).summary.read_text())["robustness"]["repeats"]
    assert [(row["simulator"], row["episodes"], row["identical"]) for row in robustness] == [
        (task.partition("/")[0], 2, 2) for task in tasks
    ]
