"""Trials of others on the page "Compare": what is not paired is not said to be."""

import pytest

from robogauntlet.results.store.foreign.csv_table import read_csv
from robogauntlet.results.store.foreign.run import import_results
from robogauntlet.results.store.history_import import record_run_folder
from tests.orchestrator.dashboard.conftest import serving
from tests.orchestrator.dashboard.test_compare_margin import shown


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """A dashboard of two imported runs, with the ids of these."""
    root = tmp_path_factory.mktemp("runs")
    with serving(root) as dashboard:
        dashboard.ids = []
        for name, won in (("sim", (9, 5, 1)), ("real", (4, 7, 1))):
            lines = [
                f"{policy},cup,{n},{int(n < own)}" for policy, own in zip("abc", won, strict=True) for n in range(10)
            ]
            results = read_csv("\n".join(["policy,task,trial,success", *lines]).encode())
            folder, document = import_results(results, [], root, suite=name, name=name)
            record_run_folder(dashboard.history, folder, document)
            dashboard.ids.append(document.run_id)
        yield dashboard


def test_two_runs_are_compared_on_separate_trials(served):
    page = shown(served.get("/compare?first={}&second={}".format(*served.ids)).text)
    assert "separate trials, not paired" in page
    assert "sim predicts real, by 3 policies in 1 task: Pearson's r 0.50" in page
    assert "a 90 % [60, 98] 40 % [17, 69]" in page
    assert "Fisher's exact test" in page
    assert "McNemar" not in page


def test_two_policies_are_compared_on_separate_trials(served):
    page = shown(served.get("/compare?first={0}:a&second={0}:b".format(*served.ids)).text)
    assert "a against b: +40.0 [" in page
    assert "Start states are not known" in page
