"""What is derived from kept runs is what it was."""

import pytest

from tests.golden.kept import KINDS
from tests.golden.record import differences
from tests.jobs import mostly_nightly


@pytest.mark.parametrize("kind", mostly_nightly(KINDS, ["clean", "gate", "merging", "robustness"]))
def test_a_kept_run_gives_what_it_gave(kind):
    lines, unplanned = differences(kind)
    assert "\n".join(lines) == ""
    if unplanned:
        pytest.skip(unplanned)
