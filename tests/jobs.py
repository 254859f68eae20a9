"""Tests that `make test` leaves to jobs of their own."""

import pytest

JOBS = ("chaos", "nightly")
"""Markers of such tests, each with the command of make that runs them."""


def mostly_nightly(values, now):
    """Values of a parameter: those of `now` are for `make test`, all others for the nightly job."""
    assert all(value in values for value in now)
    return [value if value in now else pytest.param(value, marks=pytest.mark.nightly) for value in values]
