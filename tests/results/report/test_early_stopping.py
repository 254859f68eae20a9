"""The kept run that stops early."""

from robogauntlet.results.analysis.condition_comparison import ConditionComparison, saving_of
from robogauntlet.results.analysis.failures import COLUMNS, build_failures
from robogauntlet.results.report import failures
from robogauntlet.results.report.condition_comparison import stopping_rule
from robogauntlet.results.report.parquet import read_frame
from robogauntlet.results.run_document import read_run
from tests import ROOT

KEPT = ROOT / "docs/reports/early-stopping"


def test_the_sentences_about_the_kept_run_are_those_of_its_plan_and_rows():
    run, page = read_run(KEPT), (KEPT / "README.md").read_text()
    sides = run.suite.comparison
    found = ConditionComparison(
        sides.baseline, sides.others, (), (), (), (), run.suite.adaptive, run.decided, saving_of(run)
    )
    counted = build_failures(run, read_frame(KEPT / "episodes.parquet", COLUMNS))
    for sentence in (stopping_rule(found), *failures.sentences(counted)):
        assert f"- {sentence}\n" in page
    assert any(
        f"    - {sentence}\n" in (ROOT / "docs/failures.md").read_text() for sentence in failures.sentences(counted)
    )
