"""Results of others become a run of rows, whose comparisons claim no more than the files say."""

import html
from contextlib import closing
from dataclasses import replace

import pytest

from robogauntlet.results import api
from robogauntlet.results.report.write import write_report
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.exported_run import export_run, import_run
from robogauntlet.results.store.foreign.csv_table import read_csv
from robogauntlet.results.store.foreign.run import import_results
from robogauntlet.results.store.foreign.trials import BadResults
from tests.errors import one_line_error


def table(column, *lines):
    return read_csv("\n".join([f"policy,task,{column},success", *lines]).encode())


def both(column="trial"):
    """Two policies, of which the first succeeds in 18 of 20 trials and the second in 6."""
    lines = [f"{policy},cup,{n},{n < won}" for policy, won in (("good", 18), ("bad", 6)) for n in range(20)]
    return table(column, *lines)


@pytest.fixture
def make(tmp_path):
    def call(results, name="theirs"):
        return import_results(results, [tmp_path / "a.csv"], tmp_path / "runs", suite="trials", name=name)

    return call


def test_the_rows_say_what_the_file_says_and_no_more(make):
    folder, document = make(replace(both(), trials=both().trials[:20]))
    rows = api.open_run(folder).episodes()
    assert rows["status"].tolist().count("success") == 18
    assert set(rows["state_hash"]) == set(rows["actions_hash"]) == {""}
    assert (document.origin, document.planned, document.status) == ("imported", 20, "complete")
    assert "how it was counted" in document.warnings[0]


def test_trials_are_compared_unpaired_and_the_comparison_says_so(make):
    folder, _ = make(both())
    found = api.open_run(folder).compare("good", "bad", margin=0.1)
    assert not found.comparisons
    (one,) = found.unpaired
    assert (one.overall.counts.first, one.overall.counts.second) == (18, 6)
    assert one.overall.p == pytest.approx(0.000243, rel=1e-2)  # Fisher's test of 18/20 against 6/20
    text = str(found)
    assert "good against bad: +60.0 [30.3, 77.1] points, p <0.001, not paired: 20 and 20 trials" in text
    assert "Start states are not known, so that trials are not paired." in text
    assert "It is shown that good is no worse than bad by more than 10 points." in text
    assert "McNemar" not in text


def test_what_is_left_out_and_tasks_played_unequally_often_are_named(make):
    lines = [f"{policy},cup,{n},{n % 2}" for policy, count in (("a", 30), ("b", 10)) for n in range(count)]
    lines += [*(f"{policy},pan,{n},1" for policy in "ab" for n in range(10)), *(f"b,pot,{n},0" for n in range(4))]
    found = table("trial", *lines)
    failed = replace(found.trials[0], success=None, error="timeout")
    text = str(api.open_run(make(replace(found, trials=(failed, *found.trials[1:])))[0]).compare("a", "b"))
    assert "Each has other shares of its trials in the tasks" in text
    assert "Left out: 1 error of a, 0 of b." in text
    assert "Left out, in tasks that the other did not play: 0 trials of a, 4 of b." in text
    assert "Tasks with a difference after adjustment: 0 of 2." in text


@pytest.mark.parametrize("column", ["seed", "state"])
def test_trials_with_start_states_are_paired_also_with_those_of_another_import(make, column):
    folders = [make(both(column), name)[0] for name in ("one", "two")]
    for other in (None, folders[1]):
        found = api.open_run(folders[0]).compare("good", "bad", other=other)
        assert not found.unpaired
        assert found.comparisons[0].overall.pairs.first_only == 12
        assert found.comparisons[0].identical == 0
        assert "the same actions" not in str(found)


def test_two_imports_do_not_have_the_same_policy(make, tmp_path):
    (one, _), (two, _) = make(both("seed"), "one"), import_results(both("seed"), [], tmp_path, suite="later")
    found = api.compare(one, two, allowed=frozenset(["suite"]))
    assert not any(policy.is_same_policy for policy in found.comparisons)


def test_trials_are_no_pairs_of_trials_with_states(make):
    unpaired, paired = make(both(), "one")[0], make(both("seed"), "two")[0]
    found = api.open_run(unpaired).compare("good", "bad", other=paired)
    assert (len(found.comparisons), len(found.unpaired)) == (0, 1)
    assert not api.compare(unpaired, paired).comparisons


def test_three_policies_have_letters_by_the_test_of_separate_trials(make):
    lines = [f"{name},cup,{n},{n < won}" for name, won in (("a", 19), ("b", 18), ("c", 2)) for n in range(20)]
    folder, _ = make(table("trial", *lines))
    found = api.open_run(folder).compare()
    assert [(row.policy, row.letters) for row in found.standings] == [("a", "a"), ("b", "a"), ("c", "b")]
    assert [one.overall.adjusted <= 0.05 for one in found.unpaired] == [False, True, True]


def test_a_report_is_made_and_compares_unpaired(make):
    folder, _ = make(both())
    write_report(folder)
    page = html.unescape((folder / "report.md").read_text())
    assert "good against bad: +60.0 [30.3, 77.1] points, p <0.001, not paired: 20 and 20 trials" in page
    assert "Start states are not known" in page
    assert "control steps" not in page
    assert "success: A trial that the file of others calls one" in page
    assert "No times were measured." in page
    assert "| cup | good | 20 | 20 | 18 | 2 | 0 | 0 | 90 % | [70, 97] | – | 90 % | – | – |" in page


def test_letters_of_many_policies_are_not_said_to_be_of_pairs(make):
    lines = [
        f"{name},cup,{n},{n < won}" for name, won in zip("abcde", (19, 18, 17, 2, 1), strict=True) for n in range(20)
    ]
    text = str(api.open_run(make(table("trial", *lines))[0]).compare())
    assert "Fisher's on separate trials" in text
    assert "paired by task" not in text


@pytest.mark.parametrize("results", [both(), table("seed", "a,b,2119308772572332049,1")], ids=["trials", "large seed"])
def test_a_run_is_exported_and_imported_again(make, tmp_path, results):
    folder, document = make(results)
    with closing(Store.open_begun(folder, document)) as rows:
        export_run(folder, document, rows, tmp_path / "x.zip")
    _, again = import_run(tmp_path / "x.zip", tmp_path / "again")
    assert again.rows_hash == document.rows_hash


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["a,b,1,1", "a,b,1,1"], "trial 1 of a in trials/b is there twice$"),
        (["a,b,1,1", "a,b,01,0"], "trial 1 of a in trials/b is there twice, with different outcomes"),
        (["a b,b,1,1", "a-b,b,1,1"], "got 'a b' and 'a-b': both are a-b"),
        (["?,b,1,1"], "expected a policy with a letter or digit in its name, got '\\?'"),
        ([f"a,b{n},1,1" for n in range(10_001)], "expected at most 10,000 tasks, got 10,001"),
    ],
)
def test_trials_that_are_no_run_are_refused_and_leave_nothing(make, tmp_path, lines, message):
    with one_line_error(BadResults, message):
        make(table("trial", *lines))
    assert not (tmp_path / "runs").exists()
