"""What reports show holds what it promises, in the kept rows."""

import pytest

from studies.intervals.coverage import DESIGNS
from studies.tables import kept

SHOWN = [row for row in kept("intervals", "coverage")["rows"] if not row["name"].startswith("not shown")]


@pytest.mark.parametrize("row", SHOWN, ids=lambda row: row["name"])
def test_an_interval_covers_and_a_test_rejects_as_promised(row):
    sign = 1 if row["kind"] == "covers" else -1
    found = [row[design.replace(" ", "")] for design in DESIGNS]
    assert min(sign * (share - row["promised"]) for share in found) > -0.011
    assert sign * (row["worst"] - row["promised"]) + 2 * row["error"] > -0.03
