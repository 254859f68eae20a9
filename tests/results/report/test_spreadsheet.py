"""`cells.csv` says what the tables say."""

import csv
import io

import pytest

from robogauntlet.results.report.summary import CSV_HEADER, render_csv
from robogauntlet.suites.episode import Condition
from tests.results.synthetic import cells, document, rows, tables_of

PLAN = cells(("oracle",), ("maniskill/PushCube-v1",), (Condition(), Condition("noise", 4)))


def test_every_cell_has_a_line_with_its_rate_interval_and_level():
    tables = tables_of(document(10, of=PLAN), rows(PLAN, errors=1))
    lines = list(csv.DictReader(io.StringIO(render_csv(tables))))
    assert tuple(lines[0]) == CSV_HEADER
    clean, noisy = lines
    assert (clean["axis"], clean["level"], clean["unit"]) == ("clean", "", "")
    assert (noisy["severity"], noisy["level"], noisy["unit"]) == ("4", "18.4", "dB PSNR")
    tally = tables.cells[1].tally
    assert float(noisy["rate"]) == pytest.approx(tally.successes / 9)
    assert (float(noisy["low"]), float(noisy["high"])) == (tally.interval.low, tally.interval.high)
    assert (int(noisy["done"]), int(noisy["errors"])) == (10, 1)


def test_cells_without_rows_have_no_rate():
    lines = list(csv.DictReader(io.StringIO(render_csv(tables_of(document(10, of=PLAN), [])))))
    assert {line["rate"] for line in lines} == {""}
    assert {line["missing"] for line in lines} == {"10"}
