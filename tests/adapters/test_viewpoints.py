"""Moving cameras: the geometry, and the same in three simulators."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from adapters.adjusting import ADJUSTABLE, Viewpoint
from adapters.catalog import open_simulation, simulators
from adapters.viewpoints import (
    angle_round,
    bumped,
    farther,
    looking_at,
    orbited,
    seen_at_height,
    turn_between,
    widened,
)
from suites.vocabulary import Condition, RenderProfile, View

angles = st.floats(-1.2, 1.2)
TASKS = ("maniskill/PushCube-v1", "pybullet/PandaPush-v3", "robosuite/Lift")


def nominal():
    return looking_at(np.array([1.3, 0.4, 0.6]), np.array([0.5, 0.0, 0.0]), 0.7)


def test_a_camera_that_looks_along_x_has_its_right_towards_minus_y_and_its_down_towards_minus_z():
    found = looking_at(np.zeros(3), np.array([2.0, 0.0, 0.0]), 0.7)
    np.testing.assert_allclose(found.rotation, np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]]), atol=1e-12)


def test_what_a_camera_is_aimed_at_is_found_again():
    np.testing.assert_allclose(seen_at_height(nominal(), 0.0), [0.5, 0.0, 0.0], atol=1e-12)


@given(angles, st.floats(0, 0.3))
def test_an_orbit_keeps_distance_and_aim_and_turns_by_its_angle(azimuth, elevation):
    before, centre = nominal(), np.array([0.5, 0.0, 0.0])
    after = orbited(before, centre, azimuth, elevation)
    distances = [np.linalg.norm(viewpoint.position - centre) for viewpoint in (before, after)]
    assert distances[0] == pytest.approx(distances[1])
    np.testing.assert_allclose(seen_at_height(after, 0.0), centre, atol=1e-9)
    assert angle_round(centre, before, after) == pytest.approx(abs(azimuth), abs=1e-9)
    assert after.position[2] >= before.position[2] - 1e-9
    np.testing.assert_allclose(after.rotation.T @ after.rotation, np.eye(3), atol=1e-9)


def test_an_orbit_by_nothing_changes_nothing():
    before = nominal()
    after = orbited(before, np.array([0.5, 0.0, 0.0]), 0.0, 0.0)
    np.testing.assert_allclose(after.position, before.position, atol=1e-12)
    np.testing.assert_allclose(after.rotation, before.rotation, atol=1e-12)


def test_farther_wider_and_bumped_by_hand():
    centre = np.array([0.5, 0.0, 0.0])
    np.testing.assert_allclose(farther(nominal(), centre, 2.0).position, [2.1, 0.8, 1.2])
    assert widened(nominal(), 0.1).fovy == pytest.approx(0.8)
    moved = bumped(nominal(), np.array([0.0, 0.0, 0.01]), np.array([0.0, 0.05, 0.0]))
    np.testing.assert_allclose(moved.position - nominal().position, [0, 0, 0.01])
    assert turn_between(nominal(), moved) == pytest.approx(0.05)


# In the simulators


@pytest.fixture(scope="module", params=TASKS)
def opened(request):
    simulation = open_simulation(request.param, View(image_size=64, render_profile=RenderProfile.FAST))
    yield simulation
    simulation.close()


def images(simulation, seed=3):
    return simulation.observe().images


def test_what_a_simulator_says_it_adjusts_its_simulations_offer():
    for simulator in simulators().values():
        assert simulator.adjusts <= ADJUSTABLE


@pytest.mark.simulator
@pytest.mark.parametrize("camera", ["third_person", "wrist"])
def test_a_viewpoint_that_is_set_is_read_back_and_seen_by_that_camera_alone(opened, camera):
    opened.reset(3, Condition())
    before, own = images(opened), opened.adjusters.cameras.viewpoint(camera)
    turned = Rotation.from_rotvec([0.0, 0.0, 0.2]).as_matrix() @ own.rotation
    opened.adjusters.cameras.set_viewpoint(camera, Viewpoint(own.position + 0.03, turned, own.fovy + 0.1))
    found, after = opened.adjusters.cameras.viewpoint(camera), images(opened)
    np.testing.assert_allclose(found.position, own.position + 0.03, atol=1e-5)
    np.testing.assert_allclose(found.rotation, turned, atol=1e-5)
    assert found.fovy == pytest.approx(own.fovy + 0.1, abs=1e-5)
    assert (before[camera] != after[camera]).mean() > 0.05
    other = {"third_person": "wrist", "wrist": "third_person"}[camera]
    assert (before[other] == after[other]).all()


@pytest.mark.simulator
def test_setting_the_own_viewpoint_shows_the_own_picture_but_for_rounding(opened):
    opened.reset(3, Condition())
    before = images(opened)
    for camera in before:
        opened.adjusters.cameras.set_viewpoint(camera, opened.adjusters.cameras.viewpoint(camera))
    after = images(opened)
    for camera in before:
        assert (np.abs(before[camera].astype(int) - after[camera]) > 8).mean() < 0.02


@pytest.mark.simulator
def test_a_reset_gives_every_camera_its_own_viewpoint_back_to_the_bit(opened):
    opened.reset(3, Condition())
    before, picture = images(opened), opened.picture()
    for camera in before:
        own = opened.adjusters.cameras.viewpoint(camera)
        opened.adjusters.cameras.set_viewpoint(camera, Viewpoint(own.position + 0.1, own.rotation, own.fovy + 0.2))
    opened.reset(3, Condition())
    after = images(opened)
    assert all((before[camera] == after[camera]).all() for camera in before)
    assert (picture == opened.picture()).all()


@pytest.mark.simulator
def test_the_third_person_camera_is_aimed_at_the_table_in_front_of_the_robot(opened):
    opened.reset(3, Condition())
    aim = seen_at_height(opened.adjusters.cameras.viewpoint("third_person"), 0.0)
    assert 0.3 < aim[0] < 0.9
    assert abs(aim[1]) < 0.2
    assert math.radians(30) < opened.adjusters.cameras.viewpoint("third_person").fovy < math.radians(50)
