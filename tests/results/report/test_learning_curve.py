"""A learning curve as table, sentence and page."""

import re

import pytest

from robogauntlet.results.analysis.learning_curve import CurvePoint, learning_curve
from robogauntlet.results.report.learning_curve import best_sentence, render_learning_curve, table

POINTS = [
    CurvePoint("checkpoint-500", 500, even=(3, 10), odd=(5, 10), errors=0),
    CurvePoint("checkpoint-1000", 1000, even=(9, 10), odd=(6, 9), errors=1),
    CurvePoint("checkpoint-1500", 1500, even=(0, 0), odd=(0, 0), errors=20),
]


def test_the_table_has_a_row_for_each_checkpoint():
    assert table(learning_curve("act", POINTS)).rows == (
        ("checkpoint-500", "500", "40 %", "[22, 61]", "20", "0"),
        ("checkpoint-1000", "1,000", "79 %", "[57, 91]", "19", "1"),
        ("checkpoint-1500", "1,500", "–", "–", "0", "20"),
    )


def test_the_rate_of_the_best_is_that_of_the_seeds_that_did_not_choose_it():
    assert best_sentence(learning_curve("act", POINTS)) == (
        "best: checkpoint-1000, chosen by even seeds (90 %), measured by odd seeds: 67 % [35, 88] of 9 episodes"
    )
    assert best_sentence(learning_curve("act", POINTS[2:])).startswith("best: none yet")


def test_the_page_draws_each_checkpoint_that_has_a_rate_at_its_step():
    page = render_learning_curve(learning_curve("act", POINTS), "tabletop")
    assert re.findall(r"<title>(checkpoint-\S+ .*?)</title>", page) == [
        "checkpoint-500: 40 % [22, 61]",
        "checkpoint-1000: 79 % [57, 91]",
    ]
    (drawn,) = re.findall(r'<polyline class="line" points="([^"]*)"', page)
    places = [tuple(map(float, place.split(","))) for place in drawn.split()]
    assert places == [(0.0, pytest.approx(256 * 0.6)), (150.0, pytest.approx(256 * 4 / 19))]  # of 300 x 256
    assert re.findall(r'y="271"[^>]*>([^<]*)<', page) == ["500", "750", "1,000", "1,250", "1,500"]
    assert "http://" not in page
    assert "https://" not in page


def test_a_page_of_one_checkpoint_or_none_is_drawn_and_names_are_escaped():
    one = render_learning_curve(learning_curve("<b>", [CurvePoint("<i>-5", 5, (1, 1), (1, 1), 0)]), "s")
    assert "<b>" not in one.replace("<b>RoboGauntlet", "")
    assert "<i>-5" not in one
    assert re.findall(r'y="271"[^>]*>([^<]*)<', one) == ["5"]
    assert "best: none yet" in render_learning_curve(learning_curve("act", []), "s")
