"""The behaviour columns of an episode."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from robogauntlet.adapters.catalog import goal_of, open_simulation
from robogauntlet.adapters.contract import AdapterError, Goal, Motion
from robogauntlet.orchestrator.episodes.behaviour import BehaviourMeter, openings, progress, smoothness
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.policies.catalog import load
from robogauntlet.results.record import BEHAVIOUR, OUTCOME, FailureKind, Status
from robogauntlet.suites.episode import Episode, Protocol, View
from tests.orchestrator.episodes.scripted_failures import VIEW, play_failures

REACH = Goal("tcp_position", "goal_position", tolerance=0.05)
LIFT = Goal("cube_position", offset=(0.0, 0.0, 0.1), grasped=True)
ONE_TASK_EACH = ("maniskill/StackCube-v1", "pybullet/PandaPickAndPlace-v3", "robosuite/Lift")


class Played:
    """A simulation of which only the motions are played, one by one."""

    action_spec = open_simulation("null/Reach", View()).action_spec

    def __init__(self, motions):
        self._motions = iter(motions)

    def motion(self, entries):
        return next(self._motions)


def columns(motions, goal=None, status=Status.FAILURE):
    meter = BehaviourMeter(Played(motions), goal)
    for _ in motions:
        meter.sample()
    return meter.columns(status)


def moved_to(x, *, opening=0.08, goal=0.5, **measured):
    tool = np.array([x, 0.0, 0.0])
    return Motion(tool, opening, (tool, np.array([goal, 0.0, 0.0])), **measured)


def test_the_path_is_the_way_and_not_the_distance():
    assert columns([moved_to(x) for x in (0.0, 0.1, 0.0)])["path_length"] == 0.2


def test_the_time_to_success_is_when_the_predicate_began_to_hold():
    motions = [moved_to(0.0)] * (1 + 12)
    assert columns(motions, status=Status.SUCCESS)["time_to_success"] == pytest.approx(8 / 20.0)
    assert columns(motions)["time_to_success"] is None


def test_what_was_not_measured_is_none():
    found = columns([moved_to(0.0)] * 3)
    assert [found[name] for name in ("contact_steps", "contact_force", "joint_limit_steps")] == [None] * 3
    assert not {"progress", "workspace_steps", "failure"} & set(found)


def test_contacts_and_joints_at_their_limit_are_counted_at_the_end_of_steps():
    motions = [moved_to(0.0, contact_force=9.0, joint_margin=-1.0)]  # the start
    motions += [moved_to(0.0, contact_force=f, joint_margin=m) for f, m in [(0.0, 0.5), (7.04, 0.001), (3.0, -0.1)]]
    found = columns(motions)
    assert (found["contact_steps"], found["contact_force"], found["joint_limit_steps"]) == (2, 7.0, 2)


def test_a_tool_outside_the_workspace_is_counted():
    assert columns([moved_to(x) for x in (0.0, -0.19, -0.21, 0.69, 0.71)], REACH)["workspace_steps"] == 2


def test_a_success_has_no_kind_of_failure():
    motions = [moved_to(x) for x in (0.0, 0.2, 0.5)]
    assert columns(motions, REACH, Status.SUCCESS)["failure"] is None
    assert columns(motions[:1] * 3, REACH)["failure"] == FailureKind.NOT_REACHED


def test_an_object_that_falls_onto_the_table_at_the_start_has_not_moved():
    def at(height):
        return Motion(np.zeros(3), 0.08, (np.array([0.5, 0.0, height]),))

    found = columns([at(height) for height in (0.02, 0.01, 0.0, 0.0, 0.0)], LIFT)
    assert (found["progress"], found["failure"]) == (0.0, "not-reached")


@pytest.mark.parametrize("handle", ["", "tcp_position"])
def test_an_object_that_falls_out_of_a_gripper_that_stays_up_was_dropped(handle):
    """Also if no place of the tool is asked for, as with mugs of LIBERO."""
    goal = Goal("mug_position", "goal_position", tolerance=0.03, handle=handle, grasped=True)
    place = np.array([0.5, 0.5, 0.0])

    def at(tool, mug, opening):
        entries = {goal.entry: [0.5, 0.0, mug], "tcp_position": [0.5, 0.0, tool], goal.to: place}
        names = dict.fromkeys((goal.entry, goal.handle or goal.entry, goal.to))
        return Motion(np.array([0.5, 0.0, tool]), opening, tuple(np.array(entries[name]) for name in names))

    motions = [at(0.2, 0.0, 0.08)] * 3 + [at(height, 0.0, 0.08) for height in (0.1, 0.0)]
    motions += [at(height, height, 0.04) for height in (0.0, 0.1, 0.2)] + [at(0.2, 0.0, 0.08)] * 10
    assert columns(motions, goal)["failure"] == FailureKind.DROPPED


def test_a_goal_that_does_not_fit_the_state_is_said_in_a_line():
    def at(angle):
        return Motion(np.zeros(3), 0.0, (np.array([angle]),))

    with pytest.raises(AdapterError, match=r"the task's goal: handle: expected a position, shape \(3,\), of 'hinge'"):
        columns([at(0.0), at(0.1)], Goal("hinge", offset=(0.3,)))


@pytest.mark.parametrize("changed", ["tool", "opening", "entries", "contact_force"])
def test_a_motion_that_is_not_finite_is_an_error_and_no_progress(changed):
    arrays = {"entries": (np.array([np.nan] * 3),) * 2, "tool": np.array([0.0, np.inf, 0.0])}
    motions = [moved_to(0.0), replace(moved_to(0.1), **{changed: arrays.get(changed, float("nan"))})]
    with pytest.raises(AdapterError, match="expected finite numbers in the simulation's motion"):
        columns(motions, REACH)


def test_progress_is_the_share_of_the_way_to_the_tolerance():
    assert progress(np.array([0.25, 0.3, 0.15]), 0.05) == 0.5
    assert progress(np.array([0.25, 0.01]), 0.05) == 1.0
    assert progress(np.array([0.25, 9.0]), 0.05) == -1.0
    assert [progress(np.array([0.01, last]), 0.05) for last in (0.02, 0.2)] == [1.0, -1.0]


@pytest.mark.parametrize(
    ("widths", "count"),
    [([0.08, 0.0], 0), ([0.0, 0.08], 1), ([0.0, 0.08, 0.04, 0.08], 2), ([0.0, 0.009, 0.0, 0.009], 0), ([0.02], 0)],
)
def test_openings_are_counted_with_hysteresis(widths, count):
    assert openings(widths) == count


def test_a_single_bell_is_smoother_than_one_with_tremor():
    bell = np.sin(np.linspace(0.0, np.pi, 40)) ** 2
    tremor = bell * (1.0 + 0.4 * np.cos(np.arange(40) * 2.0))
    assert smoothness(tremor, 20.0) < smoothness(bell, 20.0) < -1.0


def test_smoothness_does_not_depend_on_the_size_of_the_motion():
    bell = np.sin(np.linspace(0.0, np.pi, 40)) ** 2
    assert smoothness(bell, 20.0) == smoothness(3.0 * bell, 20.0)


@given(st.lists(st.floats(0.0, 1.0), max_size=60))
def test_smoothness_is_negative_or_none(speeds):
    found = smoothness(np.array(speeds), 20.0)
    assert found is None or (np.isfinite(found) and found <= 0.0)


def test_an_episode_of_a_task_without_goal_has_the_other_columns():
    task = "null/Reach"
    assert goal_of(task) is not None
    assert goal_of("null/None") is None
    row = rollout(open_simulation(task, View()), load("random", {}), Episode("p", "p", task, 3, Protocol(20, 8)))
    assert row.path_length > 0.0
    assert row.contact_steps is None


@pytest.mark.simulator
@pytest.mark.parametrize("task", ONE_TASK_EACH)
def test_measuring_changes_nothing(task, monkeypatch):
    simulation = open_simulation(task, VIEW)
    episode = Episode("random", "random", task, 3, Protocol(25, 8, VIEW))
    measured = rollout(simulation, load("random", {}), episode)
    monkeypatch.setattr(BehaviourMeter, "sample", lambda meter: None)
    monkeypatch.setattr(BehaviourMeter, "columns", lambda meter, status, success_hold: {})
    plain = rollout(simulation, load("random", {}), episode)
    simulation.close()
    for name in OUTCOME:
        assert name in BEHAVIOUR or getattr(measured, name) == getattr(plain, name), name
    assert measured.path_length is not None


@pytest.mark.simulator
@pytest.mark.parametrize("task", ONE_TASK_EACH)
def test_scripted_failures_get_the_kind_that_a_person_gives_them(task):
    simulation = open_simulation(task, VIEW)
    found = {kind: row.failure for kind, row in play_failures(task, simulation, 700_009) if row.status == "failure"}
    simulation.close()
    assert found == {kind: str(kind) for kind in found}
    assert len(found) >= 5
