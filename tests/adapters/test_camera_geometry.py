"""Moving cameras: the geometry. That simulators follow it is checked by `orchestrator.kit.adapter.cameras`."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from robogauntlet.adapters.camera_geometry import (
    aim_point,
    azimuth_between,
    bump,
    looking_at,
    move_away,
    orbit,
    rotation_between,
    widen,
)
from robogauntlet.adapters.catalog import simulators
from robogauntlet.adapters.scene_control import ADJUSTABLE

angles = st.floats(-1.2, 1.2)


def nominal():
    return looking_at(np.array([1.3, 0.4, 0.6]), np.array([0.5, 0.0, 0.0]), 0.7)


def test_a_camera_that_looks_along_x_has_its_right_towards_minus_y_and_its_down_towards_minus_z():
    found = looking_at(np.zeros(3), np.array([2.0, 0.0, 0.0]), 0.7)
    np.testing.assert_allclose(found.rotation, np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]]), atol=1e-12)


def test_the_aim_point_of_a_camera_is_found():
    np.testing.assert_allclose(aim_point(nominal(), 0.0), [0.5, 0.0, 0.0], atol=1e-12)


@given(angles, st.floats(0, 0.3))
def test_an_orbit_keeps_distance_and_aim_and_turns_by_its_angle(azimuth, elevation):
    before, centre = nominal(), np.array([0.5, 0.0, 0.0])
    after = orbit(before, centre, azimuth, elevation)
    distances = [np.linalg.norm(viewpoint.position - centre) for viewpoint in (before, after)]
    assert distances[0] == pytest.approx(distances[1])
    np.testing.assert_allclose(aim_point(after, 0.0), centre, atol=1e-9)
    assert azimuth_between(centre, before, after) == pytest.approx(abs(azimuth), abs=1e-9)
    assert after.position[2] >= before.position[2] - 1e-9
    np.testing.assert_allclose(after.rotation.T @ after.rotation, np.eye(3), atol=1e-9)


def test_an_orbit_of_0_changes_nothing():
    before = nominal()
    after = orbit(before, np.array([0.5, 0.0, 0.0]), 0.0, 0.0)
    np.testing.assert_allclose(after.position, before.position, atol=1e-12)
    np.testing.assert_allclose(after.rotation, before.rotation, atol=1e-12)


def test_moving_away_widening_and_bumping_have_known_values():
    centre = np.array([0.5, 0.0, 0.0])
    np.testing.assert_allclose(move_away(nominal(), centre, 2.0).position, [2.1, 0.8, 1.2])
    assert widen(nominal(), 0.1).fovy == pytest.approx(0.8)
    moved = bump(nominal(), np.array([0.0, 0.0, 0.01]), np.array([0.0, 0.05, 0.0]))
    np.testing.assert_allclose(moved.position - nominal().position, [0, 0, 0.01])
    assert rotation_between(nominal(), moved) == pytest.approx(0.05)


def test_every_declared_adjustment_exists():
    for simulator in simulators().values():
        assert simulator.adjusts <= ADJUSTABLE
