"""`robogauntlet report`: the table for a paper."""

import pytest

from robogauntlet.suites.episode import Condition
from tests.results.synthetic import cells, document, rows, run_folder

CONDITIONS = (Condition(), Condition("noise", 2), Condition("noise", 4))


@pytest.fixture
def run(tmp_path):
    plan = cells(conditions=CONDITIONS)
    return run_folder(tmp_path / "run", document(3, of=plan), rows(plan, planned=3))


def test_the_table_is_printed_and_nothing_is_written(run_command, run):
    before = {path.name for path in run.iterdir()}
    done = run_command("report", run, "--table", "latex", "--condition", "noise@4")
    assert done.code == 0
    assert done.out.startswith("% needs \\usepackage{booktabs}\n\\begin{table}")
    assert "condition noise@4" in done.out
    assert {path.name for path in run.iterdir()} == before


def test_the_table_is_that_of_the_first_condition(run_command, run):
    assert "condition clean" in run_command("report", run, "--table", "latex").out


def test_figures_are_written_beside_the_report(run_command, run):
    done = run_command("report", run, "--figures", "svg")
    assert f"figure: {run / 'figures' / 'success-by-task.svg'}" in done.out
    assert (run / "figures" / "success-by-severity.svg").is_file()
    assert (run / "report.html").is_file()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--table", "csv", "--condition", "nois@4"], "the run has no condition 'nois@4'; did you mean 'noise@4'?"),
        (
            ["--table", "csv", "--condition", "noise"],
            "expected one severity of noise, got 'noise'; the run has noise@2",
        ),
        (["--condition", "clean"], "--condition: expected with --table"),
        (["--table", "csv", "--figures", "svg"], "expected --table, which writes nothing, or --figures, got both"),
    ],
)
def test_a_mistake_is_one_line(run_command, run, arguments, message):
    assert message in run_command("report", run, *arguments).refusal
