"""What a policy is shown and what is executed under each axis, in the null simulator."""

import json
from itertools import pairwise

import numpy as np
import pytest

from robogauntlet.adapters.camera_geometry import rotation_between
from robogauntlet.adapters.catalog import open_simulation
from robogauntlet.adapters.contract import AdapterError, ObservationSpec
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.orchestrator.perturbations import images, instructions, perturbed
from robogauntlet.suites.axes import AXES, Changes
from robogauntlet.suites.episode import View
from robogauntlet.suites.paraphrases import OTHER_GOALS, PARAPHRASES
from tests.orchestrator.episodes.test_rollout import Scripted
from tests.orchestrator.perturbations.scene import Scene, begun, episode

IMAGE_AXES = [name for name, axis in AXES.items() if axis.changes is Changes.IMAGES]
ACTION_AXES = [name for name, axis in AXES.items() if axis.changes is Changes.ACTIONS]
every_axis = pytest.mark.parametrize("axis", AXES)


def top(axis):
    """The greatest severity."""
    return len(AXES[axis].levels)


def looks(axis, severity, count=12, **which):
    _, simulation = begun(axis, severity, **which)
    return [simulation.observe().images["third_person"] for _ in range(count)], simulation


def test_the_clean_condition_is_the_simulation_itself():
    scene = Scene()
    assert perturbed(scene, episode()) is scene


@pytest.fixture(autouse=True)
def other_words(monkeypatch):
    """Words for the null simulator's goal too."""
    found = dict(PARAPHRASES) | {"reach the goal": tuple(f"reach the goal, {kind}" for kind in range(1, 6))}
    goals = dict(OTHER_GOALS) | {"reach the goal": "leave the goal"}
    for name, table in (("PARAPHRASES", found), ("OTHER_GOALS", goals)):
        monkeypatch.setattr(f"robogauntlet.suites.axes.{name}", table)
        monkeypatch.setattr(instructions, name, table)


@every_axis
def test_the_world_the_instruction_and_what_the_robot_feels_stay_as_in_the_clean_episode(axis):
    _, simulation = begun(axis, top(axis))
    clean = Scene()
    clean.reset(4)
    assert (simulation.state_hash() == clean.state_hash()) == AXES[axis].changes.starts_clean
    ours, theirs = simulation.observe(), clean.observe()
    assert (ours.instruction == theirs.instruction) == (AXES[axis].changes is not Changes.INSTRUCTION)
    assert (ours.proprioception == theirs.proprioception).all()


@pytest.mark.parametrize("axis", ACTION_AXES)
def test_axes_of_actions_leave_the_images_alone(axis):
    clean = Scene()
    clean.reset(4)
    assert (looks(axis, 5, 1)[0][0] == clean.observe().images["third_person"]).all()


@pytest.mark.parametrize("axis", IMAGE_AXES)
def test_axes_of_images_leave_the_actions_alone(axis):
    scene, simulation = begun(axis, top(axis))
    action = np.array([0.01, 0.02, -0.03, 0, 0, 0, 1.0])
    simulation.step(action)
    assert (scene.told[0] == action).all()


@pytest.mark.parametrize("axis", ["noise", "blur"])
def test_images_change_more_with_severity(axis):
    clean = looks("frozen-frames", 1, 1)[0][0].astype(float)
    errors = [np.abs(looks(axis, severity, 1)[0][0] - clean).mean() for severity in range(1, 6)]
    assert errors == sorted(errors)
    assert errors[0] > 0


@pytest.mark.parametrize("severity", range(1, 6))
def test_noise_has_the_ratio_of_its_level_in_each_camera_and_is_fresh_in_every_frame(severity):
    seen, simulation = looks("noise", severity, 2)
    delivered = simulation.delivered()
    assert delivered.value == pytest.approx(AXES["noise"].value(severity), abs=0.1)
    assert {"psnr_third_person", "psnr_wrist", "mean_wrist", "saturated_wrist"} <= delivered.statistics.keys()
    assert (seen[0] != seen[1]).mean() > 0.3


@every_axis
def test_two_policies_meet_the_same_disturbance_and_two_seeds_another(axis):
    action = np.array([0.01, 0, 0, 0, 0, 0, 0.0])

    def trace(**which):
        scene, simulation = begun(axis, top(axis), **which)
        images = [simulation.observe().images["wrist"] for _ in range(6)]
        for _ in range(6):
            simulation.step(action)
        return np.stack(images), np.stack(scene.told)

    one, other, later = trace(policy="p"), trace(policy="q"), trace(policy="p", seed=5)
    assert (one[0] == other[0]).all()
    assert (one[1] == other[1]).all()
    if axis in ("noise", "action-noise"):
        assert (one[0] != later[0]).any() or (one[1] != later[1]).any()


def test_frozen_frames_repeat_the_last_look():
    seen, simulation = looks("frozen-frames", 5, 50)
    repeated = [bool((a == b).all()) for a, b in pairwise(seen)]
    assert np.mean(repeated) == pytest.approx(0.4, abs=0.05)
    assert simulation.delivered().value == pytest.approx(40, abs=3)


def test_delayed_actions_arrive_late_and_until_then_the_robot_stays():
    scene, simulation = begun("action-delay", 3)  # 200 ms at 20 Hz
    for number in range(6):
        simulation.step(np.full(7, 0.01 * number))
    told = np.stack(scene.told)[:, 0]
    assert told.tolist() == pytest.approx([0, 0, 0, 0, 0.0, 0.01])
    assert simulation.delivered().value == pytest.approx(200)


def test_action_noise_has_the_deviation_of_its_level_and_leaves_ignored_axes_alone():
    scene, simulation = begun("action-noise", 3)
    for _ in range(400):
        simulation.step(np.zeros(7))
    told = np.stack(scene.told)
    assert simulation.delivered().value == pytest.approx(2.0, rel=0.1)
    assert told[:, :3].std() == pytest.approx(0.02 / 20**0.5, rel=0.1)
    assert not told[:, 3:].any()


def test_a_blur_that_changes_nothing_is_an_error():
    simulation = perturbed(open_simulation("null/Reach", View()), episode("blur", 5))
    simulation.reset(4)
    simulation.observe()  # the null simulator's images are blank
    with pytest.raises(AdapterError, match="blur@5: expected blurred images, got what the cameras saw"):
        simulation.delivered()


def test_noise_that_misses_its_level_is_an_error(monkeypatch):
    monkeypatch.setattr(images, "noise_deviation", lambda image, target, pattern: 0.5)
    _, simulation = looks("noise", 1, 1)
    with pytest.raises(AdapterError, match=r"noise@1: expected 34 dB PSNR, delivered \d"):
        simulation.delivered()


def test_the_instruction_is_given_in_the_words_of_its_severity_and_the_images_stay():
    scene, simulation = begun("instruction", 3)
    seen = simulation.observe()
    assert seen.instruction == "reach the goal, 3"
    assert simulation.delivered().value == 3.0
    assert (seen.images["wrist"] == scene.observe().images["wrist"]).mean() > 0.9


@pytest.mark.parametrize(("control", "told"), [("blank-instruction", ""), ("wrong-goal", "leave the goal")])
def test_controls_of_the_instruction_say_nothing_or_something_else(control, told):
    _, simulation = begun(control, 1)
    assert simulation.observe().instruction == told
    assert simulation.delivered().value == 1.0


def test_a_blind_policy_is_shown_black_images():
    scene, simulation = begun("blind", 1)
    seen = simulation.observe()
    assert not any(image.any() for image in seen.images.values())
    assert simulation.delivered().value == 1.0
    assert (seen.proprioception == scene.inner.observe().proprioception).all()


def test_an_instruction_without_other_words_is_an_error(monkeypatch):
    monkeypatch.setattr("robogauntlet.suites.axes.PARAPHRASES", {})
    _, simulation = begun("instruction", 3)
    with pytest.raises(
        AdapterError, match=r"instruction@3: suites/paraphrases.py has no paraphrases of 'reach the goal'"
    ):
        simulation.observe()


CAMERA_AXES = [name for name, axis in AXES.items() if axis.changes is Changes.CAMERAS]


@pytest.mark.parametrize("severity", range(1, 6))
@pytest.mark.parametrize("axis", CAMERA_AXES)
def test_cameras_are_moved_by_the_level_as_read_back(axis, severity):
    _, simulation = begun(axis, severity)
    delivered = simulation.delivered()
    assert delivered.value == pytest.approx(AXES[axis].value(severity), abs=1e-6)
    assert "turned_third_person" in delivered.statistics


def test_a_bump_moves_every_camera_on_its_own_and_the_other_axes_the_third_person_one():
    for axis in CAMERA_AXES:
        scene, _ = begun(axis, 5)
        moved = {c for c, v in Scene().viewpoints.items() if not np.allclose(v.position, scene.viewpoints[c].position)}
        moved |= {c for c, v in Scene().viewpoints.items() if v.fovy != scene.viewpoints[c].fovy}
        assert moved == ({"third_person", "wrist"} if axis == "camera-bump" else {"third_person"})
    scene, _ = begun("camera-bump", 5)
    offsets = [scene.viewpoints[c].position - v.position for c, v in Scene().viewpoints.items()]
    assert not np.allclose(*offsets)
    assert rotation_between(Scene().viewpoints["wrist"], scene.viewpoints["wrist"]) == pytest.approx(np.radians(5))


def test_an_orbit_goes_to_either_side():
    sides = {begun("camera-orbit", 4, seed=seed)[0].viewpoints["third_person"].position[1] > 0.6 for seed in range(12)}
    assert sides == {True, False}


def test_a_camera_that_does_not_move_is_an_error(monkeypatch):
    monkeypatch.setattr(Scene, "set_viewpoint", lambda self, camera, viewpoint: None)
    _, simulation = begun("camera-orbit", 3)
    with pytest.raises(AdapterError, match=r"camera-orbit@3: expected 20 deg, delivered 0.00"):
        simulation.delivered()


def test_a_simulation_whose_cameras_cannot_be_moved_is_refused():
    simulation = perturbed(open_simulation("null/Reach", View()), episode("camera-orbit", 3))
    with pytest.raises(AdapterError, match="camera-orbit@3: this simulation does not let cameras be moved"):
        simulation.reset(4)


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


def test_rendering_for_nobody_changes_nothing():
    lazy, eager = (rollout(Scene(), Scripted(), episode("noise", 3), eager=eager) for eager in (False, True))
    assert lazy.actions_hash == eager.actions_hash
    assert lazy.delivered_statistics == eager.delivered_statistics


def test_what_a_policy_never_looks_at_is_not_measured():
    from robogauntlet.policies.contract import PolicyInput

    result = rollout(Scene(), Scripted(sees=PolicyInput.NOTHING), episode("noise", 3))
    assert result.delivered is None
