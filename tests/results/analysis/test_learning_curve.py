"""Success by checkpoint."""

from robogauntlet.results.analysis.learning_curve import COLUMNS, CurvePoint, curve_point, learning_curve
from robogauntlet.suites.episode import Condition
from tests.results.synthetic import cells, columns_of, row


def point(name, step, even=(1, 2), odd=(1, 2)):
    return CurvePoint(name, step, even, odd, errors=0)


def test_a_point_counts_the_clean_episodes_of_its_policy_by_half_and_errors_apart():
    planned = cells(("p", "oracle"), ("null/Reach", "null/Push"), (Condition(), Condition("noise", 2)))
    outcomes = ("success", "failure", "error", "success", "success")
    rows = [
        row(cell, seed, outcomes[seed] if cell.policy == "p" and cell.condition == Condition() else "success")
        for cell in planned
        for seed in range(5)
    ]
    found = curve_point("checkpoint-500", 500, "p", columns_of(rows, COLUMNS))
    assert found == CurvePoint("checkpoint-500", 500, even=(4, 4), odd=(2, 4), errors=2)
    assert found.count == (6, 8)
    assert found.estimate.value == 0.75
    assert found.estimate.interval.low < 0.75 < found.estimate.interval.high


def test_a_point_without_a_verdict_has_no_rate():
    assert point("a", 1, (0, 0), (0, 0)).estimate is None


def test_a_curve_is_in_the_order_of_steps_and_its_best_is_the_earliest_of_equal_ones():
    curve = learning_curve("p", [point("c-10", 10), point("c-9", 9, (2, 2)), point("c-200", 200, (2, 2), (0, 2))])
    assert [one.name for one in curve.points] == ["c-9", "c-10", "c-200"]
    assert (curve.best.index, curve.best.estimate.value) == (0, 0.5)
    assert learning_curve("p", []).best is None
