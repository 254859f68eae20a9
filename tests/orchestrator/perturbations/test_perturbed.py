"""Observations and executed actions under each axis, in the null simulator."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from robogauntlet.adapters.camera_geometry import rotation_between
from robogauntlet.adapters.catalog import open_simulation, task_descriptions
from robogauntlet.adapters.contract import AdapterError, Delivered, ObservationSpec
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.orchestrator.perturbations import images, instructions, perturbed
from robogauntlet.policies.contract import PolicyInput
from robogauntlet.suites.axes import AXES
from robogauntlet.suites.axis import Changes
from robogauntlet.suites.episode import View
from robogauntlet.suites.paraphrases import OTHER_GOALS, PARAPHRASES
from tests.orchestrator.episodes.test_rollout import Scripted
from tests.orchestrator.perturbations.scene import Scene, TwoArms, begin, episode

IMAGE_AXES = [name for name, axis in AXES.items() if axis.changes is Changes.IMAGES]
ACTION_AXES = [name for name, axis in AXES.items() if axis.changes is Changes.ACTIONS]
every_axis = pytest.mark.parametrize("axis", AXES)


def highest(axis):
    """The highest severity."""
    return len(AXES[axis].levels)


def images_of(axis, severity, count=12, **which):
    _, simulation = begin(axis, severity, **which)
    return [simulation.observe().images["third_person"] for _ in range(count)], simulation


def test_the_clean_condition_is_the_simulation_itself():
    scene = Scene()
    assert perturbed(scene, episode()) is scene


@pytest.fixture(autouse=True)
def paraphrases(monkeypatch):
    """Paraphrases for the null simulator's instruction."""
    paraphrased = dict(PARAPHRASES) | {"reach the goal": tuple(f"reach the goal, {kind}" for kind in range(1, 6))}
    goals = dict(OTHER_GOALS) | {"reach the goal": "leave the goal"}
    for name, table in (("PARAPHRASES", paraphrased), ("OTHER_GOALS", goals)):
        monkeypatch.setattr(f"robogauntlet.suites.paraphrases.{name}", table)
        monkeypatch.setattr(instructions, name, table)
    named = replace(task_descriptions()["null/Reach"], published_instruction="reach the goal add 3")
    monkeypatch.setattr(instructions, "task_descriptions", lambda: {"null/Reach": named})


@every_axis
def test_state_instruction_and_proprioception_are_those_of_the_clean_episode(axis):
    _, simulation = begin(axis, highest(axis))
    clean = Scene()
    clean.reset(4)
    assert (simulation.state_hash() == clean.state_hash()) == AXES[axis].changes.starts_clean
    ours, theirs = simulation.observe(), clean.observe()
    assert (ours.instruction == theirs.instruction) == (AXES[axis].changes is not Changes.INSTRUCTION)
    assert (ours.proprioception == theirs.proprioception).all()


@pytest.mark.parametrize("axis", ACTION_AXES)
def test_action_axes_do_not_change_images(axis):
    clean = Scene()
    clean.reset(4)
    assert (images_of(axis, 5, 1)[0][0] == clean.observe().images["third_person"]).all()


@pytest.mark.parametrize("axis", IMAGE_AXES)
def test_image_axes_do_not_change_actions(axis):
    scene, simulation = begin(axis, highest(axis))
    action = np.array([0.01, 0.02, -0.03, 0, 0, 0, 1.0])
    simulation.step(action)
    assert (scene.executed[0] == action).all()


@pytest.mark.parametrize("axis", ["noise", "blur"])
def test_images_change_more_with_severity(axis):
    clean = images_of("frozen-frames", 1, 1)[0][0].astype(float)
    errors = [np.abs(images_of(axis, severity, 1)[0][0] - clean).mean() for severity in range(1, 6)]
    assert errors == sorted(errors)
    assert errors[0] > 0


@pytest.mark.parametrize("severity", range(1, 6))
def test_noise_has_its_levels_psnr_in_each_camera_and_differs_between_frames(severity):
    seen, simulation = images_of("noise", severity, 2)
    delivered = simulation.delivered()
    assert delivered.value == pytest.approx(AXES["noise"].value(severity), abs=0.1)
    assert {"psnr_third_person", "psnr_wrist", "mean_wrist", "saturated_wrist"} <= delivered.statistics.keys()
    assert (seen[0] != seen[1]).mean() > 0.3


@every_axis
def test_two_policies_meet_the_same_disturbance_and_two_seeds_different_ones(axis):
    action = np.array([0.01, 0, 0, 0, 0, 0, 0.0])

    def trace(**which):
        scene, simulation = begin(axis, highest(axis), **which)
        images = [simulation.observe().images["wrist"] for _ in range(6)]
        for _ in range(6):
            simulation.step(action)
        return np.stack(images), np.stack(scene.executed)

    first, second, other_seed = trace(policy="p"), trace(policy="q"), trace(policy="p", seed=5)
    assert (first[0] == second[0]).all()
    assert (first[1] == second[1]).all()
    if axis in ("noise", "action-noise"):
        assert (first[0] != other_seed[0]).any() or (first[1] != other_seed[1]).any()


def test_frozen_frames_repeat_the_previous_image():
    seen, simulation = images_of("frozen-frames", 5, 50)
    repeated = [bool((a == b).all()) for a, b in pairwise(seen)]
    assert np.mean(repeated) == pytest.approx(0.4, abs=0.05)
    assert simulation.delivered().value == pytest.approx(40, abs=3)


def test_delayed_actions_arrive_late_and_until_then_the_robot_stays():
    scene, simulation = begin("action-delay", 3)  # 200 ms at 20 Hz
    for number in range(6):
        simulation.step(np.full(7, 0.01 * number))
    executed = np.stack(scene.executed)[:, 0]
    assert executed.tolist() == pytest.approx([0, 0, 0, 0, 0.0, 0.01])
    assert simulation.delivered().value == pytest.approx(200)


def test_action_noise_has_its_levels_deviation_and_keeps_ignored_dimensions():
    scene, simulation = begin("action-noise", 3)
    for _ in range(400):
        simulation.step(np.zeros(7))
    executed = np.stack(scene.executed)
    assert simulation.delivered().value == pytest.approx(2.0, rel=0.1)
    assert executed[:, :3].std() == pytest.approx(0.02 / 20**0.5, rel=0.1)
    assert not executed[:, 3:].any()


def test_noise_moves_each_of_two_arms_by_its_own_and_leaves_their_grippers():
    scene, simulation = begin("action-noise", 3, scene=TwoArms())
    for _ in range(400):
        simulation.step(np.zeros(14))
    executed = np.stack(scene.executed)
    assert simulation.delivered().value == pytest.approx(2.0, rel=0.1)
    first, second = executed[:, :3], executed[:, 7:10]
    assert second.std() == pytest.approx(first.std(), rel=0.1)
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.1
    assert not executed[:, [3, 4, 5, 6, 10, 11, 12, 13]].any()


def test_the_second_arm_whose_tool_is_in_another_frame_is_nothing_that_distractors_avoid():
    alone, _ = begin("distractors", 5)
    with_second, _ = begin("distractors", 5, scene=TwoArms())
    assert np.array_equal(with_second.shown(), alone.shown())


def test_two_arms_wait_with_open_grippers_for_delayed_actions():
    scene, simulation = begin("action-delay", 1, scene=TwoArms())
    simulation.step(np.full(14, 0.01))
    assert scene.executed[0].tolist() == ([0.0] * 6 + [-1.0]) * 2


def test_a_blur_that_changes_nothing_is_an_error():
    simulation = perturbed(open_simulation("null/Reach", View()), episode("blur", 5))
    simulation.reset(4)
    simulation.observe()  # the null simulator's images are blank
    with pytest.raises(AdapterError, match="blur@5: expected blurred images, got what the cameras saw"):
        simulation.delivered()


def test_noise_that_misses_its_level_is_an_error(monkeypatch):
    monkeypatch.setattr(images, "noise_deviation", lambda image, target, pattern: 0.5)
    _, simulation = images_of("noise", 1, 1)
    with pytest.raises(AdapterError, match=r"noise@1: expected 34 dB PSNR, delivered \d"):
        simulation.delivered()


def test_the_instruction_is_the_paraphrase_of_its_severity_and_images_stay():
    scene, simulation = begin("instruction", 3)
    seen = simulation.observe()
    assert seen.instruction == "reach the goal, 3"
    assert simulation.delivered() == Delivered(None, {"words_left_out": 0, "words_added": 1})
    assert (seen.images["wrist"] == scene.observe().images["wrist"]).mean() > 0.9


@pytest.mark.parametrize(
    ("control", "instruction"),
    [("blank-instruction", ""), ("wrong-goal", "leave the goal"), ("variant-name", "reach the goal add 3")],
)
def test_instruction_controls_give_no_instruction_another_goal_or_the_variants_name(control, instruction):
    _, simulation = begin(control, 1)
    assert simulation.observe().instruction == instruction
    assert simulation.delivered().value is None


def test_a_resampled_start_says_how_far_things_are_from_the_stored_state():
    _, simulation = begin("resampled", 1)
    assert simulation.delivered().value is None
    assert simulation.delivered().statistics == pytest.approx({"moved": 5.0})
    simulation.check_start()


def test_a_task_without_stored_states_is_not_resampled():
    simulation = perturbed(open_simulation("null/Reach", View()), episode("resampled", 1))
    with pytest.raises(AdapterError, match="resampled: this simulation does not let things be placed anew"):
        simulation.reset(4)


def test_a_blind_policy_gets_black_images():
    scene, simulation = begin("blind", 1)
    seen = simulation.observe()
    assert not any(image.any() for image in seen.images.values())
    assert (seen.proprioception == scene.inner.observe().proprioception).all()


def test_an_instruction_without_paraphrases_is_an_error(monkeypatch):
    monkeypatch.setattr("robogauntlet.suites.paraphrases.PARAPHRASES", {})
    _, simulation = begin("instruction", 3)
    message = r"instruction@3: suites/paraphrases.py has no paraphrases of 'reach the goal'"
    with pytest.raises(AdapterError, match=message):
        simulation.observe()


CAMERA_AXES = [name for name, axis in AXES.items() if axis.changes is Changes.CAMERAS]


@pytest.mark.parametrize("severity", range(1, 6))
@pytest.mark.parametrize("axis", CAMERA_AXES)
def test_cameras_are_moved_by_the_level(axis, severity):
    _, simulation = begin(axis, severity)
    delivered = simulation.delivered()
    assert delivered.value == pytest.approx(AXES[axis].value(severity), abs=1e-6)
    assert "turned_third_person" in delivered.statistics


def test_a_bump_moves_each_camera_differently_and_other_axes_the_third_person_camera():
    for axis in CAMERA_AXES:
        scene, _ = begin(axis, 5)
        moved = {c for c, v in Scene().viewpoints.items() if not np.allclose(v.position, scene.viewpoints[c].position)}
        moved |= {c for c, v in Scene().viewpoints.items() if v.fovy != scene.viewpoints[c].fovy}
        assert moved == ({"third_person", "wrist"} if axis == "camera-bump" else {"third_person"})
    scene, _ = begin("camera-bump", 5)
    offsets = [scene.viewpoints[c].position - v.position for c, v in Scene().viewpoints.items()]
    assert not np.allclose(*offsets)
    assert rotation_between(Scene().viewpoints["wrist"], scene.viewpoints["wrist"]) == pytest.approx(np.radians(5))


def test_an_orbit_turns_to_either_side():
    sides = {begin("camera-orbit", 4, seed=seed)[0].viewpoints["third_person"].position[1] > 0.6 for seed in range(12)}
    assert sides == {True, False}


def test_a_camera_that_does_not_move_is_an_error(monkeypatch):
    monkeypatch.setattr(Scene, "set_viewpoint", lambda self, camera, viewpoint: None)
    _, simulation = begin("camera-orbit", 3)
    with pytest.raises(AdapterError, match=r"camera-orbit@3: expected 20 deg, delivered 0.00"):
        simulation.delivered()


def test_a_suite_that_does_not_show_the_moved_camera_is_refused():
    scene = Scene()
    scene.observation_spec = ObservationSpec(("wrist",), 96)
    with pytest.raises(AdapterError, match="expected a suite that shows camera 'third_person'"):
        perturbed(scene, episode("camera-orbit", 3)).reset(4)


def test_the_record_says_what_was_delivered():
    result = rollout(Scene(), Scripted(), episode("noise", 3))
    assert result.delivered == pytest.approx(22.0, abs=0.1)
    assert json.loads(result.delivered_statistics)["psnr_wrist"] == pytest.approx(22.0, abs=0.1)
    clean = rollout(Scene(), Scripted(), episode())
    assert clean.delivered is None
    assert clean.delivered_statistics is None
    assert clean.state_hash == result.state_hash


def test_eager_rendering_changes_nothing():
    lazy, eager = (rollout(Scene(), Scripted(), episode("noise", 3), eager=eager) for eager in (False, True))
    assert lazy.actions_hash == eager.actions_hash
    assert lazy.delivered_statistics == eager.delivered_statistics


def test_nothing_is_measured_if_the_policy_never_observes():
    result = rollout(Scene(), Scripted(sees=PolicyInput.NOTHING), episode("noise", 3))
    assert result.delivered is None
