"""Perturbed scenes: light, table, distractors, objects, arm; in the null simulator."""

import math
from dataclasses import replace
from itertools import count

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import AdapterError, NotDelivered
from robogauntlet.adapters.photometry import difference, linear
from robogauntlet.adapters.scene_control import DynamicsFactors, Light, SceneControls, Unreachable
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.orchestrator.perturbations import perturbed, table_and_distractors
from robogauntlet.orchestrator.perturbations.base import ReferenceImages
from robogauntlet.orchestrator.perturbations.physics import distance_from
from robogauntlet.orchestrator.perturbations.table_and_distractors import PATTERNS, painted, pattern
from robogauntlet.policies.contract import PolicyInput
from robogauntlet.suites.axes import AXES
from robogauntlet.suites.axis import Changes
from tests.errors import one_line_error
from tests.orchestrator.episodes.test_rollout import Scripted
from tests.orchestrator.perturbations.scene import TABLE, Scene, begin, episode

SCENERY = [name for name, axis in AXES.items() if axis.changes in (Changes.LIGHTS, Changes.TABLE)]
PHYSICS = [name for name, axis in AXES.items() if axis.changes in (Changes.OBJECTS, Changes.ARM, Changes.DYNAMICS)]
severities = pytest.mark.parametrize("severity", range(1, 6))


@severities
@pytest.mark.parametrize("axis", SCENERY + PHYSICS)
def test_every_severity_delivers_its_level(axis, severity):
    for seed in (4, 5, 6):
        _, simulation = begin(axis, severity, seed=seed)
        simulation.observe()
        delivered = simulation.delivered()
        assert delivered.value == pytest.approx(AXES[axis].value(severity), abs=AXES[axis].tolerance + 1e-9)
        assert all(math.isfinite(value) for value in delivered.statistics.values())


@pytest.mark.parametrize("axis", SCENERY)
def test_the_first_and_the_second_observation_show_the_perturbed_scene(axis):
    scene, simulation = begin(axis, 4)
    first, second = (simulation.observe().images["third_person"] for _ in range(2))
    assert (first[TABLE] == second[TABLE]).all()
    clean = Scene().observe().images["third_person"]
    assert (first[32:] != clean[32:]).any()
    assert scene.frames > 2


def first_observation(axis, references=None):
    """What was delivered, the first images, and the number of rendered frames."""
    scene = Scene()
    simulation = perturbed(scene, episode(axis, 3), references)
    simulation.reset(4)
    images = simulation.observe().images
    return simulation.delivered(), images, scene.frames


@pytest.mark.parametrize("axis", SCENERY)
def test_a_cached_reference_saves_frames_and_changes_no_result(axis, monkeypatch):
    monkeypatch.setattr(Scene, "drift", 0)
    references = ReferenceImages()
    delivered, images, frames = first_observation(axis)
    first_observation(axis, references)
    again, kept, fewer = first_observation(axis, references)
    assert again == delivered
    assert all((kept[camera] == image).all() for camera, image in images.items())
    assert fewer == (frames - 3 if axis == "table" else 1)


@pytest.mark.parametrize("axis", SCENERY)
def test_nothing_is_rendered_for_a_policy_that_does_not_observe(axis):
    scene = Scene()
    result = rollout(scene, Scripted(sees=PolicyInput.NOTHING), episode(axis, 3))
    assert result.delivered is None
    assert scene.frames == 0


@pytest.mark.parametrize("axis", SCENERY)
def test_a_scene_that_does_not_change_is_an_error(axis, monkeypatch):
    for name in ("set_light", "show", "paint_table"):
        monkeypatch.setattr(Scene, name, lambda self, *what: None)
    monkeypatch.setattr(Scene, "_image", lambda self, camera: np.full((96, 96, 3), 90, np.uint8))
    _, simulation = begin(axis, 3)
    with pytest.raises(AdapterError, match=rf"{axis}@3: expected"):
        simulation.observe()


@pytest.mark.parametrize("axis", SCENERY + PHYSICS)
def test_a_simulation_without_the_control_is_refused(axis):
    scene = Scene()
    scene.scene_controls = SceneControls(cameras=scene)
    with pytest.raises(AdapterError, match=rf"{axis}@3: this simulation does not let"):
        perturbed(scene, episode(axis, 3)).reset(4)


def test_light_that_misses_its_level_is_an_error(monkeypatch):
    def set_half(scene, light):
        scene.now = Light(light.gain**0.5, light.direction)

    monkeypatch.setattr(Scene, "set_light", set_half)
    _, simulation = begin("illuminance", 4)
    with pytest.raises(AdapterError, match=r"illuminance@4: expected 2 EV darker, delivered 1.0"):
        simulation.observe()


def test_illuminance_keeps_the_colour_and_colour_temperature_the_luminance():
    scene, _ = begin("illuminance", 3)
    np.testing.assert_allclose(scene.now.gain, 2**-1.5)
    scene, _ = begin("colour-temperature", 5)
    red, green, blue = scene.now.gain
    assert red > 1 > green > blue
    assert 0.2126 * red + 0.7152 * green + 0.0722 * blue == pytest.approx(1.0)


def test_light_directions_are_above_the_horizon_and_vary():
    directions = np.array([begin("light-direction", 5, seed=seed)[0].now.direction for seed in range(8)])
    assert (directions[:, 2] >= math.sin(math.radians(10)) - 1e-9).all()
    assert np.ptp(directions[:, 1]) > 0.3


@severities
def test_distractors_have_the_levels_number_keep_clear_of_objects_and_half_have_task_colours(severity):
    for seed in range(6):
        scene, _ = begin("distractors", severity, seed=seed)
        state = scene.privileged_state()
        assert len(scene.props) == AXES["distractors"].value(severity)
        own = [prop for prop in scene.props if prop.colour in table_and_distractors.TASK_COLOURS]
        assert len(own) == math.ceil(len(scene.props) / 2)
        for prop in scene.props:
            assert prop.position[2] == pytest.approx(prop.size / 2)
            reach = prop.size / math.sqrt(2) + 0.03 + 0.05
            for thing in ("cube", "other", "tcp"):
                assert np.linalg.norm(prop.position[:2] - state[f"{thing}_position"][:2]) >= reach
            ends = (state[f"{thing}_position"][:2] for thing in ("cube", "other"))
            assert table_and_distractors.distance_to_segment(prop.position[:2], *ends) >= reach


def test_distractors_behind_the_arm_are_drawn_anew_and_those_that_stay_hidden_are_an_error(monkeypatch):
    monkeypatch.setattr(Scene, "arm", (slice(0, 96), slice(0, 40)))
    scene, simulation = begin("distractors", 5)
    before = list(scene.props)
    simulation.observe()
    assert simulation.delivered().value == 10
    assert 0 < len(set(map(id, before)) & set(map(id, scene.props))) < 10
    monkeypatch.setattr(Scene, "arm", (slice(0, 96), slice(0, 60)))
    with pytest.raises(NotDelivered, match=r"distractors@5: expected 10 objects, delivered \d\.00"):
        begin("distractors", 5)[1].observe()


def test_a_table_without_room_for_the_distractors_is_not_delivered():
    scene = Scene()
    scene.table_edges = np.array([[0.3, 0.2], [0.45, 0.35]])
    with one_line_error(NotDelivered, "the table has no room for 10 props, only for [1-4]$"):
        begin("distractors", 5, scene=scene)


@severities
def test_the_table_has_a_different_mean_colour_and_the_pattern_of_its_severity(severity):
    _, simulation = begin("table", severity)
    clean = linear(Scene().observe().images["third_person"][TABLE])
    seen = linear(simulation.observe().images["third_person"][TABLE])
    delivered = difference(seen.mean(axis=(0, 1)), clean.mean(axis=(0, 1)))
    assert delivered == pytest.approx(AXES["table"].value(severity), abs=5.0)
    deviation = seen.std(axis=(0, 1)).max()
    assert (deviation > 0.01) == (severity >= 3)


def test_tables_differ_between_seeds_and_not_between_policies():
    textures = [begin("table", 2, **which) for which in ({"policy": "p"}, {"policy": "q"}, {"seed": 9})]
    for _, simulation in textures:
        simulation.observe()
    first, second, other_seed = (scene.texture for scene, _ in textures)
    assert (first == second).all()
    assert (first != other_seed).any()


@severities
def test_the_object_lies_outside_its_region_on_any_side(severity):
    sides = set()
    for seed in range(24):
        scene, simulation = begin("object-position", severity, seed=seed)
        box, where = scene.placeable()["cube"], scene.things["cube"][:2]
        assert distance_from(box, where) == pytest.approx(AXES["object-position"].value(severity) / 100)
        sides.add(tuple(np.sign(np.round(where - np.clip(where, box.low, box.high), 6)).tolist()))
        assert simulation.delivered().value == pytest.approx(AXES["object-position"].value(severity))
    assert sides == {(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)}


def test_an_object_is_not_moved_onto_the_goal(monkeypatch):
    own_state = Scene.privileged_state
    goal = np.array([0.63, 0.05, 0.0])  # just beyond one side of the region
    monkeypatch.setattr(Scene, "privileged_state", lambda self: own_state(self) | {"goal_position": goal})
    for seed in range(12):
        scene, _ = begin("object-position", 3, seed=seed)
        assert np.linalg.norm(scene.things["cube"][:2] - goal[:2]) >= 0.13  # as near as in the clean episode


def test_an_object_is_not_moved_onto_another():
    for seed in range(12):
        scene = Scene()
        scene.things["other"] = np.array([0.5, 0.12, 0.02])
        perturbed(scene, episode("object-position", 1, seed=seed)).reset(4)
        assert np.linalg.norm(scene.things["cube"] - scene.things["other"]) >= 0.06


@severities
def test_the_tool_starts_at_a_reachable_distance_and_rotated(severity):
    axis = AXES["robot-start"]
    starts = []
    for seed in range(8):
        scene, simulation = begin("robot-start", severity, seed=seed)
        own, (position, quaternion) = Scene().tool, scene.tool
        assert np.linalg.norm(position - own[0]) == pytest.approx(axis.value(severity) / 100)
        assert position[0] <= 0.5
        assert position[2] >= 0.03
        turned = (Rotation.from_quat(quaternion) * Rotation.from_quat(own[1]).inv()).magnitude()
        assert math.degrees(turned) == pytest.approx(axis.secondary_levels[severity - 1])
        assert simulation.delivered().statistics["turned"] == pytest.approx(axis.secondary_levels[severity - 1])
        starts.append(position)
    assert np.ptp(starts, axis=0).min() > 0.01


def test_no_reachable_start_is_an_error(monkeypatch):
    def refuse(self, position, quaternion):
        raise Unreachable("never")

    monkeypatch.setattr(Scene, "place_tool", refuse)
    with pytest.raises(AdapterError, match="robot-start@2: expected a start that the arm can reach"):
        begin("robot-start", 2)


def test_objects_become_heavier_and_have_more_or_less_friction():
    frictions = {round(begin("dynamics", 4, seed=seed)[0].factors.friction, 6) for seed in range(12)}
    assert frictions == {2.0, 0.5}
    assert begin("dynamics", 4)[0].factors.mass == 3.0


def test_an_unchanged_mass_is_an_error(monkeypatch):
    monkeypatch.setattr(Scene, "dynamics", lambda self: DynamicsFactors())
    _, simulation = begin("dynamics", 4)
    with pytest.raises(AdapterError, match=r"dynamics@4: expected 3 times the mass, delivered 1.00"):
        simulation.delivered()


@pytest.mark.parametrize("axis", ["illuminance", "noise", "dynamics"])
def test_a_changed_start_state_is_an_error_on_an_axis_that_keeps_it(axis, monkeypatch):
    hashes = iter("abcdefgh")
    monkeypatch.setattr(Scene, "state_hash", lambda self: next(hashes))
    with pytest.raises(AdapterError, match=rf"{axis}@3: expected the clean episode's physical state, got another"):
        rollout(Scene(), Scripted(), episode(axis, 3))


@pytest.mark.parametrize("axis", ["object-position", "robot-start"])
def test_an_unchanged_start_state_is_an_error_on_an_axis_that_changes_it(axis, monkeypatch):
    monkeypatch.setattr(Scene, "state_hash", lambda self: "same")
    with pytest.raises(
        AdapterError, match=rf"{axis}@3: expected a physical state other than the clean one, got the clean one"
    ):
        rollout(Scene(), Scripted(), episode(axis, 3))


def test_a_changed_instruction_is_an_error_on_an_axis_that_keeps_it(monkeypatch):
    seen = Scene.observe
    monkeypatch.setattr(Scene, "observe", lambda self: replace(seen(self), instruction="reach the goal view 341"))
    message = "noise@3: expected the task's own instruction, got 'reach the goal view 341'"
    with pytest.raises(AdapterError, match=message):
        rollout(Scene(), Scripted(), episode("noise", 3))


def test_images_are_rendered_once_per_seed_and_scene():
    references, rendered = ReferenceImages(), count(1)
    keys = ((1, "clean"), (1, "clean"), (2, "clean"), (1, "x"))
    assert [references.get(*key, lambda: next(rendered)) for key in keys] == [1, 1, 2, 3]


def test_the_most_recently_used_images_are_kept():
    references, rendered = ReferenceImages(size=2), count(1)
    found = [references.get(seed, "clean", lambda: next(rendered)) for seed in (1, 2, 1, 3, 1, 3, 2)]
    assert found == [1, 2, 1, 3, 1, 3, 4]


@given(st.sampled_from(PATTERNS), st.integers(0, 2**32 - 1), st.lists(st.floats(0.0, 1.0), min_size=3, max_size=3))
def test_a_pattern_keeps_the_mean_colour_and_valid_reflectances(name, seed, colour):
    values = pattern(name, np.random.default_rng(seed))
    np.testing.assert_allclose(values.mean(axis=(0, 1)), 0.0, atol=1e-9)
    assert np.abs(values).max() <= 1.0 + 1e-12
    texture = painted(np.array(colour), values)
    np.testing.assert_allclose(texture.mean(axis=(0, 1)), colour, atol=1e-9)
    assert texture.min() >= 0.0
    assert texture.max() <= 1.0


def test_only_plain_patterns_are_uniform():
    deviations = {name: pattern(name, np.random.default_rng(0)).std() for name in PATTERNS}
    assert deviations["plain"] == 0.0
    assert min(value for name, value in deviations.items() if name != "plain") > 0.3
