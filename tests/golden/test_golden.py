"""What is derived from kept runs is what it was."""

import pytest

from tests.golden.kept import KINDS
from tests.golden.record import differences


@pytest.mark.parametrize("kind", KINDS)
def test_a_kept_run_gives_what_it_gave(kind):
    lines, unplanned = differences(kind)
    assert "\n".join(lines) == ""
    if unplanned:
        pytest.skip(unplanned)
