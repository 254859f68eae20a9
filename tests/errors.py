"""Errors as tests expect them."""

from contextlib import contextmanager

import pytest


@contextmanager
def one_line_error(kind, match=None):
    """Expects this error, with a message of one line."""
    with pytest.raises(kind, match=match) as caught:
        yield caught
    assert "\n" not in str(caught.value)
