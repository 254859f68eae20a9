"""The check of a policy judges targets of joints: their units, where they begin, and how fast they change."""

from dataclasses import replace

import numpy as np
import pytest

from robogauntlet.adapters.contract import ActionSpec, Joint, Observation
from robogauntlet.orchestrator.kit.finding import Level
from robogauntlet.orchestrator.kit.policy import joints
from robogauntlet.orchestrator.kit.policy.observation import sensitivity
from robogauntlet.orchestrator.kit.policy.recording import Answer, Play
from robogauntlet.policies.contract import Decision, PolicyInput, PolicySpec, Query, StatelessPolicy
from robogauntlet.suites.episode import Episode, Protocol
from tests.orchestrator.kit.policy.test_check import checked, found, only

SPEC = ActionSpec(0.0, 0.0, 20.0, joints=(Joint("pan", -1.0, 1.0, 0.1), Joint("lift", -2.0, 2.0, 0.1)))
START = np.array([0.2, -1.0])
SMALL = 16
"""Size of images (px), which take most of the time of a check in the simulation."""
POLICY = """
import numpy as np

def act(images, proprioception, instruction):
    targets = np.tile(proprioception, (4, 1))
    targets[:, :] += np.linspace(0.25, 1, 4)[:, None] * np.array({step})
    return {scale} * targets
"""


def played(actions):
    """A play of one answer with these targets, from `START`."""
    actions = np.column_stack([actions, np.ones(len(actions))])
    episode = Episode("p", "", "so101/Push", 0, Protocol(len(actions)))
    answer = Answer(Query(episode, 0, None, None), actions, 0.0)
    return Play(episode, (answer,), np.zeros((len(actions) + 1, 3)), {}, START, success=False)


def judged(actions):
    """Level and text of the findings by topic."""
    return {finding.topic: (finding.level, finding.text) for finding in joints.targets([played(actions)], SPEC)}


def going(*steps):
    """Targets that go from the start in steps of this size."""
    return START + np.outer(np.arange(1, 11), steps)


@pytest.mark.parametrize(
    ("actions", "level", "text"),
    [
        (going(0.05, 0.05), Level.OK, "ranges; the first are at most 0.05 rad from where the joints are"),
        (np.degrees(going(0.05, 0.05)), Level.WARNING, "are not radians: degrees (joint_scale: 0.01745)"),
        (np.full((10, 2), 0.05), Level.WARNING, "the first target is 1.1 rad from where lift is: changes instead of"),
        (-going(0.05, 0.05), Level.WARNING, "the first target is 1.9 rad from where lift is"),
        (going(0.1, 0.0), Level.NOTE, "20 % of the actions have targets beyond a joint's range, and are clipped (pan)"),
        (going(0.4, 0.0), Level.WARNING, "80 % of the actions have targets beyond a joint's range"),
    ],
)
def test_units_and_start_of_targets_are_judged(actions, level, text):
    finding = judged(actions)["targets"]
    assert (finding[0], text in finding[1]) == (level, True), finding


@pytest.mark.parametrize(
    ("actions", "topic", "level", "text"),
    [
        ([[1.0, -2.0], [0.5, 0.0]], "velocities", Level.OK, "up to 2 rad/s"),
        (
            [[1.0, -2.5]] + 3 * [[0.5, 0.0]],
            "velocities",
            Level.NOTE,
            "25 % of the actions are beyond the limit of 2 rad/s",
        ),
        ([[57.0, 0.0], [50.0, 0.0]], "velocities", Level.WARNING, "and are clipped: targets, or degrees?"),
        ([[0.0, 0.0]], "motion", Level.WARNING, "all velocities are 0: the policy stands still"),
    ],
)
def test_velocities_beyond_those_of_the_joints_are_told(actions, topic, level, text):
    spec = replace(SPEC, velocities=True)
    findings = {finding.topic: finding for finding in joints.velocities([played(np.array(actions))], spec)}
    assert (findings[topic].level, text in findings[topic].text) == (level, True), findings


@pytest.mark.parametrize(
    ("actions", "level", "text"),
    [
        (np.insert(going(0.05, 0.1), 5, START, axis=0), Level.NOTE, "in 20 % of the steps a joint cannot follow"),
        (going(0.05, 0.1), Level.OK, "up to 0.1 rad per step, and the joints can follow"),
        (going(0.05, 0.2), Level.WARNING, "up to 0.2 rad per step; in 100 % of the steps a joint cannot follow"),
    ],
)
def test_targets_that_change_faster_than_the_joints_are_told(actions, level, text):
    finding = judged(actions)["speed"]
    assert (finding[0], text in finding[1]) == (level, True), finding


@pytest.mark.parametrize(
    ("ahead", "text"),
    [
        (0.01, "no target leaves where the arm starts: the policy stands still"),
        (0.2, "all 3 actions are the same: 0.4, -0.8, 1"),
    ],
)
def test_constant_targets_are_told(ahead, text):
    assert judged(np.tile(START + ahead, (3, 1)))["motion"] == (Level.WARNING, text)


def test_a_single_target_has_no_speed():
    assert set(judged(going(0.05, 0.05)[:1])) == {"targets"}


def test_a_joint_that_the_task_ignores_is_not_judged(monkeypatch):
    monkeypatch.setitem(globals(), "SPEC", replace(SPEC, ignored=("lift",)))
    assert judged(going(0.05, 50.0))["targets"][0] is Level.OK


def test_the_gripper_does_not_inflate_what_a_joint_changes():
    """An open gripper's command is close to what it measures."""
    seen = Observation({"wrist": np.zeros((16, 16, 3), np.uint8)}, np.array([0.2, -1.0, -0.999]), "", of_joints=True)

    class Gripping(StatelessPolicy):
        spec = PolicySpec(PolicyInput.OBSERVATION, 1, action_dim=None)

        def act(self, queries):
            closed = [0.5 if query.observation.instruction else -0.5 for query in queries]
            return [Decision(np.array([[0.3, -0.9, value]])) for value in closed]

    asked = Answer(Query(played(going(0.1, 0.1)).episode, 0, seen, None), np.zeros((1, 3)), 0.0)
    findings = [finding.text for finding in sensitivity(Gripping(), [asked])]
    assert "other instruction: the actions change by 200 % of their size" in findings


@pytest.mark.simulator
@pytest.mark.nightly
def test_each_joint_is_told_by_what_it_moves_in_the_simulation(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    text = POLICY.format(step="[0.1, 0, 0, 0, 0.1, 0]", scale=1.0)
    (tmp_path / "joints_right.py").write_text(text)
    options = {"callable": "joints_right:act", "folder": str(tmp_path)}
    results = checked("python", options, "so101/PickPlace", image_size=SMALL)
    assert only(results, "targets").level is Level.OK
    assert "rad alone moves the tool right (-y)" in only(results, "shoulder_pan").text
    assert "and turns it +" in only(results, "wrist_roll").text
    assert only(results, "wrist_roll").numbers["z_rad"] > 0.1
    assert only(results, "wrist_flex").text.endswith("always near its start")
    fingers = only(results, "fingers").numbers
    assert fingers["open_m"] > fingers["closed_m"] + 0.02
    assert found(results, "translation") == []
    assert results[-1].dtype == np.uint8


@pytest.mark.simulator
def test_the_oracle_is_well_in_a_task_of_joints():
    results = checked("oracle", {}, "so101/PickPlace")
    assert {only(results, topic).level for topic in ("targets", "speed", "approach", "state")} == {Level.OK}
    assert only(results, "input").text == "the policy gets the true state instead of images"


@pytest.mark.simulator
def test_targets_in_degrees_are_told_with_the_option_that_converts_them(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "joints_degrees.py").write_text(POLICY.format(step="[0.1, 0, 0, 0, 0, 0]", scale=57.3))
    options = {"callable": "joints_degrees:act", "folder": str(tmp_path)}
    results = checked("python", options, "so101/PickPlace", image_size=SMALL)
    assert any("images black: the same actions" in finding.text for finding in found(results, "input"))
    assert "degrees (joint_scale: 0.01745)" in only(results, "targets").text
    assert only(results, "gripper").level is Level.WARNING
