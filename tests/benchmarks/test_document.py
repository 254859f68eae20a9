"""Tables of measurements in the documentation are those of the committed rows."""

import json

import pandas as pd
import pytest

from tests.benchmarks import operators
from tests.benchmarks.document import BLOCK, MEASUREMENTS, PAGES, with_measurements


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_pages_show_the_committed_measurements(page):
    text = page.read_text(encoding="utf-8")
    assert with_measurements(text) == text


def test_every_committed_measurement_is_shown():
    shown = {name for page in PAGES for _, name in BLOCK.findall(page.read_text(encoding="utf-8"))}
    assert shown == {path.stem for path in MEASUREMENTS.glob("*.json")}


def test_rates_of_operators_are_those_of_the_committed_episodes():
    rows = json.loads((MEASUREMENTS / "operators.json").read_text(encoding="utf-8"))["rows"]
    frame = pd.read_parquet(MEASUREMENTS / "operators.parquet")
    assert operators.rows_of(frame, {row["policy"]: row["kilobytes"] for row in rows}) == rows
