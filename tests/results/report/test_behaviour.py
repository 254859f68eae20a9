"""Tables of how robots move."""

from robogauntlet.results.report.sections import behaviour
from robogauntlet.results.report.sections.behaviour import COLUMNS, build_behaviour
from tests.results.synthetic import cells, columns_of, document, row

PLAN = cells(("a", "b"), ("maniskill/A",))


def built(*results):
    return build_behaviour(document(2, PLAN), columns_of(results, COLUMNS))


def test_medians_come_with_quartiles_and_units():
    rows = built(*(row(PLAN[0], seed, path_length=0.1 * seed, time_to_success=2.0) for seed in range(5)))
    table = behaviour.success_table(rows)
    assert table.header == ("task", "policy", "successes", "path length (m)", "time to success (s)")
    assert table.rows == (("maniskill/A", "a", "5", "0.20 (0.10 to 0.30)", "2.00 (2.00 to 2.00)"),)


def test_what_was_not_measured_has_no_column_and_no_number():
    table = behaviour.episode_table(
        built(row(PLAN[0], 0, contact_steps=10, contact_force=7.25), row(PLAN[1], 0, "failure", progress=-0.001))
    )
    assert table.header == (
        *("task", "policy", "episodes", "progress", "progress of failures"),
        *("contact (steps)", "largest force (N)"),
    )
    assert table.rows[0][3:] == ("–", "–", "25 %", "7.2")
    assert table.rows[1][3:] == ("0.00 (0.00 to 0.00)", "0.00 (0.00 to 0.00)", "–", "–")
