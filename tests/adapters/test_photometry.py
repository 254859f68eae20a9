"""Light and colour against published values and their own inverses."""

import math
import sys

import numpy as np
import pytest
from hypothesis import given, strategies as st

from robogauntlet.adapters.photometry import (
    LUMINANCE,
    channel_gains,
    difference,
    encoded,
    lab,
    light_of_lab,
    linear,
    stops,
    temperature_gains,
    temperature_of,
)
from tests.processes import run_process

channels = st.floats(0.0, 1.0)


def test_linear_light_is_iec_61966s():
    """The standard's own formula: 188 is about half the light, and the foot of the curve is a line."""
    found = linear(np.array([0.0, 10.0, 188.0, 255.0]))
    np.testing.assert_allclose(found, [0.0, 10 / 255 / 12.92, ((188 / 255 + 0.055) / 1.055) ** 2.4, 1.0], rtol=1e-6)
    assert found[2] == pytest.approx(0.503, abs=0.001)


@given(st.lists(channels, min_size=3, max_size=3))
def test_encoding_and_cielab_are_undone_by_their_inverses(values):
    light = np.array(values)
    np.testing.assert_allclose(linear(encoded(light)), light, atol=1e-6)
    np.testing.assert_allclose(light_of_lab(lab(light)), light, atol=1e-4)


def test_cielab_of_the_primaries_is_the_published_one():
    """Bruce Lindbloom's calculator (http://www.brucelindbloom.com), sRGB primaries under D65."""
    np.testing.assert_allclose(lab(np.array([1.0, 0.0, 0.0])), [53.24, 80.09, 67.20], atol=0.15)
    np.testing.assert_allclose(lab(np.array([0.0, 0.0, 1.0])), [32.30, 79.19, -107.86], atol=0.15)
    np.testing.assert_allclose(lab(np.ones(3)), [100.0, 0.0, 0.0], atol=0.02)
    assert difference(np.ones(3), np.zeros(3)) == pytest.approx(100.0, abs=0.02)


@pytest.mark.parametrize("kelvin", [2000.0, 2700.0, 3500.0, 4500.0, 5500.0, 6500.0])
def test_a_colour_temperature_is_found_again_and_keeps_the_luminance(kelvin):
    gains = temperature_gains(kelvin)
    assert gains @ LUMINANCE == pytest.approx(1.0)
    assert temperature_of(gains) == pytest.approx(kelvin, rel=1e-4)
    assert temperature_of(3.0 * gains) == pytest.approx(kelvin, rel=1e-4)


def test_daylight_changes_nothing():
    np.testing.assert_allclose(temperature_gains(6500.0), 1.0)


def test_a_temperature_without_red_or_blue_is_unknown():
    assert math.isnan(temperature_of(np.array([math.nan, 1.0, 1.0])))


@given(st.floats(-3.0, 0.0), st.integers(0, 2**32 - 1))
def test_dimmed_images_give_their_stops_back_whatever_part_is_saturated_or_unlit(ev, seed):
    generator = np.random.default_rng(seed)
    image = generator.integers(0, 256, (32, 32, 3)).astype(np.uint8)
    dimmed = np.rint(encoded(linear(image) * 2.0**ev)).astype(np.uint8)
    dimmed[:8] = image[:8]
    gains, lit = channel_gains([(image, dimmed)])
    assert lit <= 0.75
    if ev < -0.1:
        assert stops(gains) == pytest.approx(ev, abs=0.06)


def test_unchanged_images_show_no_light():
    image = np.full((4, 4, 3), 100, np.uint8)
    gains, lit = channel_gains([(image, image)])
    assert np.isnan(gains).all()
    assert lit == 0.0


def test_measuring_light_leaves_numpys_way_of_writing_floats():
    """The import of colour-science shortens them to 12 digits, in the tables that pandas writes, too."""
    code = "import numpy as np; from robogauntlet.adapters.photometry import linear; linear(np.zeros(3)); "
    assert run_process([sys.executable, "-c", code + "print(np.array([1 / 3]).astype(str)[0])"]).stdout == f"{1 / 3}\n"
