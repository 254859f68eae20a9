"""Success by the robot that plays a task."""

from robogauntlet.results.analysis.robots import compare_robots
from robogauntlet.results.report import write_report
from robogauntlet.results.report.robots import robot_table
from robogauntlet.results.statistics.rates import rate_difference
from robogauntlet.suites.episode import Condition
from tests.results.synthetic import cells, document, row, run_folder, tables_of

LIGHT = Condition("light", 3)
PLAN = cells(("oracle",), ("robosuite/Lift", "robosuite/Door", "robosuite/Lift@UR5e"), (Condition(), LIGHT))
WON = {"robosuite/Lift": 8, "robosuite/Lift@UR5e": 5, "robosuite/Door": 1}
ROWS = [
    row(cell, seed, "success" if seed < WON[cell.task] and cell.condition != LIGHT else "failure")
    for cell in PLAN
    for seed in range(10)
]


def test_a_task_of_several_robots_has_a_row_for_each_and_others_have_none():
    rows = compare_robots(tables_of(document(10, of=PLAN), ROWS))
    assert [(one.task, one.robot, one.tally.successes) for one in rows] == [
        ("robosuite/Lift", "", 8),
        ("robosuite/Lift", "UR5e", 5),
    ]
    assert [one.difference for one in rows] == [None, rate_difference((5, 10), (8, 10))]


def test_the_table_has_the_difference_to_the_first_robot_in_points():
    table = robot_table(compare_robots(tables_of(document(10, of=PLAN), ROWS)))
    assert table.rows == (
        ("robosuite/Lift", "oracle", "default", "80 % [49, 94]", "–"),
        ("robosuite/Lift", "oracle", "UR5e", "50 % [24, 76]", "-30.0 [-60.0, 10.7]"),
    )


def test_a_robot_without_a_verdict_has_no_difference():
    rows = compare_robots(tables_of(document(10, of=PLAN), ROWS[:10]))
    assert [one.difference for one in rows] == [None, None]


def test_reports_have_the_table_only_if_a_task_has_several_robots(tmp_path):
    for name, plan in {"several": PLAN, "one": PLAN[:2]}.items():
        folder = run_folder(
            tmp_path / name,
            document(10, of=plan),
            [one for one in ROWS if one.task in dict.fromkeys(cell.task for cell in plan)],
        )
        report = write_report(folder)
        for path in (report.paths.html, report.paths.markdown):
            assert ("By robot" in path.read_text(encoding="utf-8")) is (name == "several")
