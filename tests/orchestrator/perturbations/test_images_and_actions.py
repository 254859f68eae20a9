"""The perturbation of images and actions, which is the same in every simulator."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from robogauntlet.orchestrator.perturbations.actions import delay_steps, step_deviation
from robogauntlet.orchestrator.perturbations.base import generator_for
from robogauntlet.orchestrator.perturbations.images import (
    add_noise,
    blur,
    blur_between,
    gaussian_kernel,
    is_frozen,
    noise_deviation,
    psnr,
)
from robogauntlet.orchestrator.replay.first_observation import _measure
from robogauntlet.suites.episode import Condition

GREY = np.full((96, 96, 3), 128, np.uint8)
WHITE = np.full((96, 96, 3), 255, np.uint8)


def pattern(image, seed=0):
    return np.random.default_rng(seed).standard_normal(image.shape)


def edge():
    image = np.zeros((96, 96, 3), np.uint8)
    image[:, 48:] = 255
    return image


def test_psnr_of_a_known_difference():
    assert psnr(GREY, GREY) == math.inf
    assert psnr(GREY + np.uint8(1), GREY) == pytest.approx(20 * math.log10(255))


@pytest.mark.parametrize(("deviation", "ratio"), [(0.02, 34.0), (0.04, 28.0), (0.08, 22.0), (0.12, 18.4), (0.18, 14.9)])
def test_without_saturation_the_levels_match_the_published_deviations(deviation, ratio):
    assert psnr(add_noise(GREY, deviation, pattern(GREY)), GREY) == pytest.approx(ratio, abs=0.15)


@pytest.mark.parametrize("image", [GREY, WHITE, edge()], ids=["grey", "white", "edge"])
@pytest.mark.parametrize("ratio", [34.0, 28.0, 22.0, 18.4, 14.9])
def test_the_requested_psnr_is_delivered_despite_saturation(image, ratio):
    noise = pattern(image)
    assert psnr(add_noise(image, noise_deviation(image, ratio, noise), noise), image) == pytest.approx(ratio, abs=0.1)


def test_a_white_image_needs_more_noise_for_the_same_psnr():
    ours, theirs = (noise_deviation(image, 22.0, pattern(image)) for image in (GREY, WHITE))
    assert theirs == pytest.approx(ours * 2**0.5, rel=0.05)


def test_a_blur_keeps_uniform_images_and_spreads_an_edge_by_its_deviation():
    assert (blur(GREY, 2.7) == GREY).all()
    profile = blur(edge(), 2.7)[50, :, 0] / 255
    position = np.arange(96) + 0.5 - 48
    expected = [0.5 * (1 + math.erf(x / (2.7 * 0.96) / 2**0.5)) for x in position]
    np.testing.assert_allclose(profile, expected, atol=0.03)


@pytest.mark.parametrize("deviation", [0.2, 0.288, 1.0, 2.6])
def test_the_kernel_has_the_requested_deviation_even_below_a_pixel(deviation):
    kernel = gaussian_kernel(deviation)
    places = np.arange(len(kernel)) - len(kernel) // 2
    assert (kernel * places**2).sum() == pytest.approx(deviation**2, rel=1e-3)
    assert kernel.sum() == pytest.approx(1)


def test_the_smallest_blur_changes_a_small_image():
    assert (blur(edge(), 0.3) != edge()).any()


@pytest.mark.parametrize("deviation", [0.3, 1.0, 2.7])
def test_a_blur_is_measured_by_the_high_frequencies_that_are_lost_and_none_without_a_loss(deviation):
    image = np.random.default_rng(0).integers(0, 256, (96, 96, 3), dtype=np.uint8)
    assert blur_between([(image, blur(image, deviation)), (edge(), blur(edge(), deviation))]) == pytest.approx(
        deviation, abs=0.02
    )
    assert blur_between([(image, image)]) == pytest.approx(0.0, abs=0.01)


def test_a_blur_is_relative_to_the_width():
    small, large = edge(), np.kron(edge(), np.ones((2, 2, 1), np.uint8))
    np.testing.assert_allclose(blur(large, 1.8)[1::2, 1::2], blur(small, 1.8), atol=30)


@settings(max_examples=50)
@given(st.floats(0.5, 99), st.floats(0, 1, exclude_max=True), st.integers(2, 400))
def test_frozen_observations_have_the_requested_share_are_evenly_spread_and_never_first(share, phase, observations):
    frozen = [is_frozen(index, share, phase) for index in range(observations)]
    assert not frozen[0]
    assert abs(sum(frozen) - (observations - 1) * share / 100) <= 1


def test_delays_are_the_nearest_whole_steps_half_a_step_rounded_up_and_at_least_one():
    assert [delay_steps(ms, 20.0) for ms in (50, 100, 200, 300, 400)] == [1, 2, 4, 6, 8]
    assert [delay_steps(ms, 25.0) for ms in (50, 100, 200, 300, 400)] == [1, 3, 5, 8, 10]
    assert delay_steps(10, 20.0) == 1


def test_step_noise_adds_up_to_the_same_deviation_after_a_second_at_any_rate():
    for hz in (20.0, 25.0, 100.0):
        steps = np.random.default_rng(0).standard_normal((4000, int(hz))) * step_deviation(2.0, hz)
        assert steps.sum(axis=1).std() == pytest.approx(0.02, rel=0.05)


def test_what_a_condition_delivers_in_a_task_is_measured_without_a_policy():
    assert [*_measure("null/Reach", [Condition("action-delay", 4), Condition("table", 4)])] == [300.0, None]


def test_draws_depend_only_on_their_key():
    assert generator_for("ab", 1).random() == generator_for("ab", 1).random()
    assert len({generator_for(key, n).random() for key in ("ab", "ac") for n in (0, 1)}) == 4
