"""Arms of robosuite by the targets and velocities of their joints, DROID's among them."""

import numpy as np
import pytest

from robogauntlet.adapters.contract import Moves
from robogauntlet.adapters.motion import standing_still
from robogauntlet.adapters.robosuite import SIMULATOR
from robogauntlet.orchestrator.perturbations import perturbed
from robogauntlet.policies.contract import PolicyInput, PolicyMismatch, PolicySpec, check_fit, check_tasks
from robogauntlet.suites.axes import AXES
from robogauntlet.suites.episode import Condition, Episode, Protocol, RenderProfile, View
from tests.errors import one_line_error
from tests.jobs import mostly_nightly
from tests.policies.playing import steps_to_success

VIEW = View(image_size=48, render_profile=RenderProfile.FAST)
VELOCITY, POSITION = "Lift@DROID-joint-velocity", "Lift@DROID-joint-position"
BY_JOINTS = [name for name, task in SIMULATOR.tasks.items() if task.joints]


@pytest.fixture(scope="module")
def arms():
    opened = {name: SIMULATOR.open(name, VIEW) for name in (VELOCITY, POSITION)}
    yield opened
    for simulation in opened.values():
        simulation.close()


def test_tasks_by_joints_have_as_many_numbers_as_their_arms_joints_and_grippers():
    numbers = {name: SIMULATOR.tasks[name].body.action_dim for name in BY_JOINTS}
    assert {name.partition("@")[2].partition("-")[0]: count for name, count in numbers.items()} == {
        **{"DROID": 8, "UR5e": 7, "TwoPandas": 16}
    }


@pytest.mark.simulator
def test_a_velocity_turns_a_joint_by_as_many_radians_in_a_second_and_no_other(arms):
    simulation = arms[VELOCITY]
    assert simulation.action_spec.control_hz == 15.0
    simulation.reset(0)
    start = simulation.privileged_state()["joint_angles"]
    for _ in range(15):
        simulation.step(np.array([0.0, 0.0, 0.4, 0.0, 0.0, 0.0, 0.0, -1.0]))
    turned = simulation.privileged_state()["joint_angles"] - start
    assert turned == pytest.approx([0.0, 0.0, 0.4, 0.0, 0.0, 0.0, 0.0], abs=0.02)


@pytest.mark.simulator
def test_velocities_and_the_targets_that_they_lead_to_are_one_motion(arms):
    generator, ends = np.random.default_rng(0), {}
    turns = generator.uniform(-0.1, 0.1, (20, 7))
    for name, simulation in arms.items():
        simulation.reset(3)
        for turn in turns:
            target = simulation.privileged_state()["joint_targets"] + turn
            simulation.step(np.append(15.0 * turn if name == VELOCITY else target, 1.0))
        ends[name] = simulation.privileged_state()
    for entry, error in (("joint_targets", 1e-9), ("joint_angles", 1e-3)):
        assert ends[VELOCITY][entry] == pytest.approx(ends[POSITION][entry], abs=error)


@pytest.mark.simulator
def test_an_arm_that_holds_its_targets_stays(arms):
    for simulation in arms.values():
        simulation.reset(1)
        start = simulation.privileged_state()["joint_angles"]
        still = np.append(start if simulation is arms[POSITION] else np.zeros(7), -1.0)
        for _ in range(30):
            simulation.step(still)
        assert simulation.privileged_state()["joint_angles"] == pytest.approx(start, abs=2e-3)


@pytest.mark.simulator
def test_the_droid_arm_starts_as_the_data_set_s_with_the_fingers_left_and_right(arms):
    arms[VELOCITY].reset(0)
    state = arms[VELOCITY].privileged_state()
    assert state["joint_angles"] == pytest.approx(np.pi * np.array([0.0, -0.2, 0.0, -0.8, 0.0, 0.6, 0.0]), abs=0.1)
    assert abs(state["tcp_quaternion"][0]) == pytest.approx(1.0, abs=0.01)
    exterior = arms[VELOCITY].scene_controls.cameras.viewpoint("third_person")
    assert exterior.position == pytest.approx([0.05, 0.57, 0.66])


@pytest.mark.simulator
def test_the_gripper_goes_to_the_position_of_its_command(arms):
    simulation = arms[VELOCITY]
    for command in (-1.0, 0.0, 1.0):
        simulation.reset(0)
        for _ in range(20):
            simulation.step(np.append(np.zeros(7), command))
        assert simulation.privileged_state()["gripper"] == pytest.approx([command], abs=0.1)


@pytest.mark.simulator
@pytest.mark.parametrize("task", mostly_nightly(BY_JOINTS, ["TwoArmLift@TwoPandas-joint-position"]))
def test_the_oracle_succeeds_by_joints(task):
    assert None not in steps_to_success(SIMULATOR, task, range(1), noises=(0.0, 0.01))


@pytest.mark.simulator
@pytest.mark.parametrize("name", [VELOCITY, POSITION])
def test_noise_moves_the_tool_as_far_as_its_level_says(arms, name):
    episode = Episode("p", "p", f"robosuite/{name}", 0, Protocol(8), Condition("action-noise", 2))
    simulation = perturbed(arms[name], episode)
    simulation.reset(0)
    for _ in range(60):
        simulation.step(standing_still(simulation))
    assert simulation.delivered().value == pytest.approx(AXES["action-noise"].value(2), rel=0.3)


@pytest.mark.simulator
@pytest.mark.parametrize(("severity", "delivered"), [(1, 200 / 3), (2, 400 / 3), (4, 1000 / 3)])
def test_a_delay_is_the_nearest_number_of_control_steps_whatever_their_length(arms, severity, delivered):
    episode = Episode("p", "p", f"robosuite/{VELOCITY}", 0, Protocol(8), Condition("action-delay", severity))
    simulation = perturbed(arms[VELOCITY], episode)
    simulation.reset(0)
    simulation.step(standing_still(simulation))
    assert simulation.delivered().value == pytest.approx(delivered)


@pytest.mark.parametrize(
    ("moves", "task", "other"),
    [
        (Moves.TARGETS, VELOCITY, "velocities of joints, the policy produces targets of joints"),
        (Moves.TOOL, "Lift@UR5e-joint-position", "targets of joints, the policy produces motions of the tool"),
    ],
)
def test_a_policy_whose_numbers_mean_something_else_is_refused_before_the_first_step(moves, task, other):
    numbers = SIMULATOR.tasks[task].body.action_dim
    spec = PolicySpec(PolicyInput.OBSERVATION, 8, numbers, moves=moves)
    assert not spec.can_act_in(f"robosuite/{task}")
    with one_line_error(PolicyMismatch, f"robosuite/{task} accepts {other}$"):
        check_tasks(spec, [f"robosuite/{task}"])


@pytest.mark.simulator
def test_a_policy_of_targets_does_not_fit_a_simulation_of_velocities(arms):
    spec = PolicySpec(PolicyInput.OBSERVATION, 8, 8, moves=Moves.TARGETS)
    with one_line_error(PolicyMismatch, "the simulation accepts velocities of joints, the policy produces targets"):
        check_fit(spec, arms[VELOCITY].action_spec, arms[VELOCITY].observation_spec)
