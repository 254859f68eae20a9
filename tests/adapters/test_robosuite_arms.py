"""The arms of robosuite's tasks beside the Panda; `python -m studies oracles --measure oracles` plays all of them."""

import ast
import re

import numpy as np
import pytest

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import AdapterError, SimulatorUnavailable, UnknownTask
from robogauntlet.adapters.mujoco_parts.fingers import Pads
from robogauntlet.adapters.robosuite import SIMULATOR
from robogauntlet.adapters.robosuite.arms import ARMS, PANDA
from robogauntlet.adapters.robosuite.tasks import WITH_PANDA
from robogauntlet.orchestrator.registry import load_registry
from robogauntlet.policies.oracles.robosuite import SLOWER_STEP, SLOWER_TURN
from robogauntlet.suites.episode import RenderProfile, View
from robogauntlet.suites.schema import expand_tasks, robots_by_task, with_robots
from tests import ROOT
from tests.adapters.control_steps import check_compiled, ours, played, robosuites
from tests.errors import one_line_error
from tests.jobs import mostly_nightly
from tests.policies.playing import steps_to_success

OTHERS = [arm for arm in ARMS if arm != PANDA]
BY_JOINTS = [f"{arm}-joint-{what}" for arm in ("DROID", "UR5e") for what in ("position", "velocity")]
STEPS, STEP = 5, 0.01
"""Number and length (m) of the steps that are measured."""


def test_suites_can_let_every_arm_play_lift_stack_and_door():
    known = load_registry().tasks
    for task in ("robosuite/Lift", "robosuite/Stack", "robosuite/Door"):
        named = [task, *(f"{task}@{arm}" for arm in OTHERS)]
        assert with_robots([task], ARMS, robots_by_task(known)) == named
    assert robots_by_task(known)["robosuite/PickPlaceCan"] == {PANDA: "robosuite/PickPlaceCan"}


@pytest.fixture(scope="module", params=mostly_nightly(OTHERS, ["Kinova3", "UR5e"]))
def lift(request):
    opened = SIMULATOR.open(f"Lift@{request.param}", View(image_size=48, render_profile=RenderProfile.FAST))
    yield opened
    opened.close()


@pytest.mark.simulator
def test_a_step_is_robosuites_own_to_the_bit(lift):
    check_compiled(lift)
    assert np.array_equal(played(lift, 0, robosuites), played(lift, 0, ours))


@pytest.mark.simulator
def test_the_fingers_positions_are_distances_from_the_closed_gripper(lift):
    lift.reset(0)
    for gripper, low, high in ((-1.0, 0.03, 0.06), (1.0, 0.0, 0.002)):
        for _ in range(40):
            lift.step(np.array([0.0] * 6 + [gripper]))
        positions = lift.privileged_state()["finger_positions"]
        assert positions.shape == (2,)
        assert np.all((low <= positions) & (positions <= high))


@pytest.mark.simulator
def test_the_tool_moves_by_the_action_in_steady_motion(lift):
    for axis, sign in ((0, 1), (1, 1), (1, -1), (2, 1)):
        lift.reset(0)
        action = np.zeros(7)
        action[axis] = sign * STEP
        positions = []
        for _ in range(2 * STEPS + 1):
            lift.step(action)
            positions.append(lift.privileged_state()["tcp_position"][axis])
        assert positions[-1] - positions[STEPS] == pytest.approx(STEPS * sign * STEP, rel=0.25)


@pytest.mark.simulator
def test_the_motions_of_scripts_are_within_the_bounds_of_every_arm(lift):
    assert lift.action_spec.max_translation >= SLOWER_STEP
    assert lift.action_spec.max_rotation >= SLOWER_TURN


@pytest.mark.simulator
def test_the_tool_is_brought_to_another_start_whatever_joints_and_gripper_the_arm_has(lift):
    lift.reset(0)
    state = lift.privileged_state()
    place = state["tcp_position"] + [0.0, 0.04, 0.02]
    lift.scene_controls.arm.place_tool(place, state["tcp_quaternion"])
    assert lift.privileged_state()["tcp_position"] == pytest.approx(place, abs=1e-3)


@pytest.mark.simulator
@pytest.mark.parametrize("task", mostly_nightly(["Lift@IIWA", "Stack@UR5e", "Door@XArm7"], ["Lift@IIWA"]))
def test_the_panda_s_oracle_succeeds_with_another_arm(task):
    assert None not in steps_to_success(SIMULATOR, task, range(2), noises=(0.1,))


def test_a_pattern_finds_other_arms_only_if_it_names_one():
    known = catalog.task_descriptions()
    assert expand_tasks(["robosuite/*"], known) == [f"robosuite/{task}" for task in WITH_PANDA]
    assert expand_tasks(["robosuite/Lift@*"], known) == [f"robosuite/Lift@{arm}" for arm in OTHERS + BY_JOINTS]
    assert expand_tasks(["robosuite/*@UR5e"], known) == [f"robosuite/{task}@UR5e" for task in ("Lift", "Stack", "Door")]


def test_an_arm_that_does_not_exist_is_refused_with_the_nearest():
    with pytest.raises(UnknownTask, match="unknown task 'robosuite/Lift@UR5'; did you mean 'robosuite/Lift@UR5e'"):
        catalog.open_simulation("robosuite/Lift@UR5", View())


def test_an_arm_is_an_entry_of_at_most_ten_lines_and_the_docs_show_one():
    code = (ROOT / "adapters" / "robosuite" / "arms.py").read_text(encoding="utf-8")
    table = next(node for node in ast.parse(code).body if isinstance(node, ast.AnnAssign) and node.target.id == "ARMS")
    assert all(entry.end_lineno - entry.lineno < 10 for entry in table.value.values)
    section = (
        (ROOT / "docs" / "adapters.md").read_text(encoding="utf-8").partition("## Tasks that several robots play")[2]
    )
    shown = re.findall(r"```python\n(.*?)```", section, re.DOTALL)[:1]
    assert [entry.split('"')[1] for entry in shown] == ["Kinova3"]
    assert all(entry in code for entry in shown)


@pytest.mark.simulator
def test_pads_that_the_model_lacks_are_one_line(lift):
    with one_line_error(AdapterError, "expected shapes of the model as pads of the fingers, got others: .*nothing"):
        Pads(lift._physics, "gripper0_right_eef", (["nothing"], ["nothing"]))


@pytest.mark.simulator
def test_an_arm_without_its_files_is_one_line(monkeypatch, tmp_path):
    of_arm = "robosuite.models.robots.manipulators.ur5e_robot.xml_path_completion"
    monkeypatch.setattr(of_arm, lambda path: str(tmp_path / path))
    with one_line_error(SimulatorUnavailable, "a file of robosuite is missing .*install it again: pip install"):
        SIMULATOR.open("Lift@UR5e", View(image_size=48))
