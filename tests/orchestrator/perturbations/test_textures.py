"""Patterns of painted tables."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from robogauntlet.orchestrator.perturbations.table_and_distractors import PATTERNS, painted, pattern


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
