"""Success by the robot that plays a task."""

from dataclasses import replace

from robogauntlet.results.report import write_report
from robogauntlet.results.report.sections.robots import compare_robots, robot_table
from robogauntlet.results.statistics.rates import rate_difference
from robogauntlet.suites.episode import Condition
from tests.results.synthetic import cells, document, row, run_folder, tables_of

LIGHT = Condition("illuminance", 3)
PLAN = cells(("oracle",), ("robosuite/Lift", "robosuite/Door", "robosuite/Lift@UR5e"), (Condition(), LIGHT))
ROBOTS = {"robosuite/Lift": "Panda", "robosuite/Door": "Panda", "robosuite/Lift@UR5e": "UR5e"}
WON = {"robosuite/Lift": 8, "robosuite/Lift@UR5e": 5, "robosuite/Door": 1}
ROWS = [
    row(cell, seed, "success" if seed < WON[cell.task] and cell.condition != LIGHT else "failure")
    for cell in PLAN
    for seed in range(10)
]


def test_a_task_of_several_robots_has_a_row_for_each_and_others_have_none():
    rows = compare_robots(ROBOTS, tables_of(document(10, of=PLAN), ROWS))
    assert [(one.task, one.robot, one.tally.successes) for one in rows] == [
        ("robosuite/Lift", "Panda", 8),
        ("robosuite/Lift", "UR5e", 5),
    ]
    assert [one.difference for one in rows] == [None, rate_difference((5, 10), (8, 10))]


def test_the_table_has_the_difference_to_the_first_robot_in_points():
    table = robot_table(compare_robots(ROBOTS, tables_of(document(10, of=PLAN), ROWS)))
    assert table.rows == (
        ("robosuite/Lift", "oracle", "Panda", "80 % [49, 94]", "–"),
        ("robosuite/Lift", "oracle", "UR5e", "50 % [24, 76]", "-30.0 [-60.0, 10.7]"),
    )


def test_a_robot_without_a_verdict_has_no_difference():
    rows = compare_robots(ROBOTS, tables_of(document(10, of=PLAN), ROWS[:10]))
    assert [one.difference for one in rows] == [None, None]


def test_a_task_that_one_robot_plays_has_no_rows_even_with_two_versions_of_a_policy():
    again = [replace(cell, policy_digest="other") for cell in PLAN[:1]]
    rows = compare_robots(ROBOTS, tables_of(document(10, of=[*PLAN[:1], *again]), ROWS[:10]))
    assert rows == ()


def test_reports_have_the_table_only_if_a_task_has_several_robots(tmp_path):
    for name, plan in {"several": PLAN, "one": PLAN[:2]}.items():
        folder = run_folder(
            tmp_path / name,
            document(10, of=plan, robots=ROBOTS),
            [one for one in ROWS if one.task in dict.fromkeys(cell.task for cell in plan)],
        )
        report = write_report(folder)
        for path in (report.paths.html, report.paths.markdown):
            assert ("By robot" in path.read_text(encoding="utf-8")) is (name == "several")
