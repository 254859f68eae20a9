"""Perturbed worlds: light, table, distractors, things, arm; in a scene of the null simulator."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import AdapterError
from robogauntlet.adapters.photometry import difference, linear
from robogauntlet.adapters.scene_control import DynamicsFactors, Light, SceneControls, Unreachable
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.orchestrator.perturbations import perturbed, table_and_distractors
from robogauntlet.orchestrator.perturbations.base import ReferenceImages
from robogauntlet.orchestrator.perturbations.physics import distance_from
from robogauntlet.policies.contract import PolicyInput
from robogauntlet.suites.axes import AXES, Changes
from tests.orchestrator.episodes.test_rollout import Scripted
from tests.orchestrator.perturbations.scene import TABLE, Scene, begun, episode

SCENERY = [name for name, axis in AXES.items() if axis.changes in (Changes.LIGHTS, Changes.STAGE)]
WORLD = [name for name, axis in AXES.items() if axis.changes in (Changes.OBJECTS, Changes.ARM, Changes.BODIES)]
severities = pytest.mark.parametrize("severity", range(1, 6))


@severities
@pytest.mark.parametrize("axis", SCENERY + WORLD)
def test_what_is_delivered_is_the_level_in_every_severity(axis, severity):
    for seed in (4, 5, 6):
        _, simulation = begun(axis, severity, seed=seed)
        simulation.observe()
        delivered = simulation.delivered()
        assert delivered.value == pytest.approx(AXES[axis].value(severity), abs=AXES[axis].tolerance + 1e-9)
        assert all(math.isfinite(value) for value in delivered.statistics.values())


@pytest.mark.parametrize("axis", SCENERY)
def test_the_first_look_and_the_next_show_the_perturbed_scene(axis):
    scene, simulation = begun(axis, 4)
    first, second = (simulation.observe().images["third_person"] for _ in range(2))
    assert (first[TABLE] == second[TABLE]).all()
    clean = Scene().observe().images["third_person"]
    assert (first[32:] != clean[32:]).any()
    assert scene.shown_looks > 2


def first_observation(axis, references=None):
    """What was delivered, the first look, and how often the scene was drawn for it."""
    scene = Scene()
    simulation = perturbed(scene, episode(axis, 3), references)
    simulation.reset(4)
    images = simulation.observe().images
    return simulation.delivered(), images, scene.shown_looks


@pytest.mark.parametrize("axis", SCENERY)
def test_a_kept_reference_saves_frames_and_changes_nothing(axis, monkeypatch):
    monkeypatch.setattr(Scene, "drift", 0)
    references = ReferenceImages()
    delivered, images, frames = first_observation(axis)
    first_observation(axis, references)
    again, kept, fewer = first_observation(axis, references)
    assert again == delivered
    assert all((kept[camera] == image).all() for camera, image in images.items())
    assert fewer == (frames - 3 if axis == "table" else 1)


@pytest.mark.parametrize("axis", SCENERY)
def test_a_policy_that_does_not_look_has_nothing_rendered_for_it(axis):
    scene = Scene()
    result = rollout(scene, Scripted(sees=PolicyInput.NOTHING), episode(axis, 3))
    assert result.delivered is None
    assert scene.shown_looks == 0


@pytest.mark.parametrize("axis", SCENERY)
def test_scenery_that_does_not_change_is_an_error(axis, monkeypatch):
    for name in ("set_light", "show", "paint_table"):
        monkeypatch.setattr(Scene, name, lambda self, *what: None)
    monkeypatch.setattr(Scene, "_image", lambda self, camera: np.full((96, 96, 3), 90, np.uint8))
    _, simulation = begun(axis, 3)
    with pytest.raises(AdapterError, match=rf"{axis}@3: expected"):
        simulation.observe()


@pytest.mark.parametrize("axis", SCENERY + WORLD)
def test_a_world_that_cannot_be_adjusted_is_refused(axis):
    scene = Scene()
    scene.scene_controls = SceneControls(cameras=scene)
    with pytest.raises(AdapterError, match=rf"{axis}@3: this simulation does not let"):
        perturbed(scene, episode(axis, 3)).reset(4)


def test_light_that_misses_its_level_is_an_error(monkeypatch):
    monkeypatch.setattr(
        Scene, "set_light", lambda self, light: setattr(self, "now", Light(light.gain**0.5, light.direction))
    )
    _, simulation = begun("illuminance", 4)
    with pytest.raises(AdapterError, match=r"illuminance@4: expected 2 EV darker, delivered 1.0"):
        simulation.observe()


def test_dimmed_light_has_one_colour_and_tinted_light_one_luminance():
    scene, _ = begun("illuminance", 3)
    np.testing.assert_allclose(scene.now.gain, 2**-1.5)
    scene, _ = begun("colour-temperature", 5)
    red, green, blue = scene.now.gain
    assert red > 1 > green > blue
    assert 0.2126 * red + 0.7152 * green + 0.0722 * blue == pytest.approx(1.0)


def test_light_comes_from_above_the_horizon_and_from_different_sides():
    directions = np.array([begun("light-direction", 5, seed=seed)[0].now.direction for seed in range(8)])
    assert (directions[:, 2] >= math.sin(math.radians(10)) - 1e-9).all()
    assert np.ptp(directions[:, 1]) > 0.3


@severities
def test_distractors_are_as_many_as_asked_clear_of_the_things_and_half_in_the_tasks_colours(severity):
    for seed in range(6):
        scene, _ = begun("distractors", severity, seed=seed)
        state = scene.privileged_state()
        assert len(scene.props) == AXES["distractors"].value(severity)
        own = [prop for prop in scene.props if prop.colour in table_and_distractors.TASK_COLOURS]
        assert len(own) == math.ceil(len(scene.props) / 2)
        for prop in scene.props:
            assert prop.position[2] == pytest.approx(prop.size / 2)
            reach = prop.size / math.sqrt(2) + 0.03 + 0.05
            for thing in ("cube", "other", "tcp"):
                assert np.linalg.norm(prop.position[:2] - state[f"{thing}_position"][:2]) >= reach
            way = table_and_distractors.distance_to_segment(
                prop.position[:2], state["cube_position"][:2], state["other_position"][:2]
            )
            assert way >= reach


@severities
def test_the_table_has_another_mean_colour_and_the_pattern_of_its_severity(severity):
    _, simulation = begun("table", severity)
    clean = linear(Scene().observe().images["third_person"][TABLE])
    seen = linear(simulation.observe().images["third_person"][TABLE])
    assert difference(seen.mean(axis=(0, 1)), clean.mean(axis=(0, 1))) == pytest.approx(
        AXES["table"].value(severity), abs=5.0
    )
    deviation = seen.std(axis=(0, 1)).max()
    assert (deviation > 0.01) == (severity >= 3)


def test_tables_differ_between_seeds_and_not_between_policies():
    textures = [begun("table", 2, **which) for which in ({"policy": "p"}, {"policy": "q"}, {"seed": 9})]
    for _, simulation in textures:
        simulation.observe()
    one, other, later = (scene.texture for scene, _ in textures)
    assert (one == other).all()
    assert (one != later).any()


@severities
def test_the_object_lies_outside_its_region_on_any_side(severity):
    sides = set()
    for seed in range(24):
        scene, simulation = begun("object-position", severity, seed=seed)
        box, where = scene.placeable()["cube"], scene.things["cube"][:2]
        assert distance_from(box, where) == pytest.approx(AXES["object-position"].value(severity) / 100)
        sides.add(tuple(np.sign(np.round(where - np.clip(where, box.low, box.high), 6)).tolist()))
        assert simulation.delivered().value == pytest.approx(AXES["object-position"].value(severity))
    assert sides == {(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)}


def test_an_object_is_not_put_onto_the_goal(monkeypatch):
    told = Scene.privileged_state
    goal = np.array([0.63, 0.05, 0.0])  # just beyond one side of the region
    monkeypatch.setattr(Scene, "privileged_state", lambda self: told(self) | {"goal_position": goal})
    for seed in range(12):
        scene, _ = begun("object-position", 3, seed=seed)
        assert np.linalg.norm(scene.things["cube"][:2] - goal[:2]) >= 0.13  # as near as in the clean episode


def test_an_object_is_not_put_onto_another():
    for seed in range(12):
        scene = Scene()
        scene.things["other"] = np.array([0.5, 0.12, 0.02])

        perturbed(scene, episode("object-position", 1, seed=seed)).reset(4)
        assert np.linalg.norm(scene.things["cube"] - scene.things["other"]) >= 0.06


@severities
def test_the_arm_starts_at_a_distance_that_it_can_reach_and_turned(severity):
    axis = AXES["robot-start"]
    starts = []
    for seed in range(8):
        scene, simulation = begun("robot-start", severity, seed=seed)
        own, (position, quaternion) = Scene().tool, scene.tool
        assert np.linalg.norm(position - own[0]) == pytest.approx(axis.value(severity) / 100)
        assert position[0] <= 0.5
        assert position[2] >= 0.03
        turned = (Rotation.from_quat(quaternion) * Rotation.from_quat(own[1]).inv()).magnitude()
        assert math.degrees(turned) == pytest.approx(axis.secondary_levels[severity - 1])
        assert simulation.delivered().statistics["turned"] == pytest.approx(axis.secondary_levels[severity - 1])
        starts.append(position)
    assert np.ptp(starts, axis=0).min() > 0.01


def test_an_arm_that_cannot_turn_is_moved_only(monkeypatch):
    monkeypatch.setattr(Scene, "turns", False)
    scene, simulation = begun("robot-start", 3)
    assert np.allclose(scene.tool[1], Scene().tool[1])
    assert simulation.delivered().statistics["turned"] == pytest.approx(0.0)


def test_an_arm_that_can_reach_nothing_is_an_error(monkeypatch):
    def refuse(self, position, quaternion):
        raise Unreachable("never")

    monkeypatch.setattr(Scene, "place_tool", refuse)
    with pytest.raises(AdapterError, match="robot-start@2: expected a start that the arm can reach"):
        begun("robot-start", 2)


def test_things_become_heavier_and_either_more_or_less_slippery():
    frictions = {round(begun("dynamics", 4, seed=seed)[0].factors.friction, 6) for seed in range(12)}
    assert frictions == {2.0, 0.5}
    assert begun("dynamics", 4)[0].factors.mass == 3.0


def test_a_mass_that_stays_is_an_error(monkeypatch):
    monkeypatch.setattr(Scene, "dynamics", lambda self: DynamicsFactors())
    _, simulation = begun("dynamics", 4)
    with pytest.raises(AdapterError, match=r"dynamics@4: expected 3 times the mass, delivered 1.00"):
        simulation.delivered()


@pytest.mark.parametrize("axis", ["illuminance", "noise", "dynamics"])
def test_an_axis_that_moves_nothing_and_starts_elsewhere_is_an_error(axis, monkeypatch):
    hashes = iter("abcdefgh")
    monkeypatch.setattr(Scene, "state_hash", lambda self: next(hashes))
    with pytest.raises(AdapterError, match=rf"{axis}@3: expected the clean episode's physical state, got another"):
        rollout(Scene(), Scripted(), episode(axis, 3))


@pytest.mark.parametrize("axis", ["object-position", "robot-start"])
def test_an_axis_that_moves_something_and_starts_as_the_clean_episode_is_an_error(axis, monkeypatch):
    monkeypatch.setattr(Scene, "state_hash", lambda self: "same")
    with pytest.raises(AdapterError, match=rf"{axis}@3: expected another physical state than the clean one, got it"):
        rollout(Scene(), Scripted(), episode(axis, 3))


def test_other_words_on_an_axis_that_changes_none_are_an_error(monkeypatch):
    seen = Scene.observe
    monkeypatch.setattr(Scene, "observe", lambda self: replace(seen(self), instruction="reach the goal view 341"))
    with pytest.raises(
        AdapterError, match=r"noise@3: expected the task's own instruction, got 'reach the goal view 341'"
    ):
        rollout(Scene(), Scripted(), episode("noise", 3))
