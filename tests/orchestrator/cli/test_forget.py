"""`robogauntlet list runs --forget`."""

from contextlib import closing

import pytest

from robogauntlet.results.run_document import read_run
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.run_history import History
from robogauntlet.support.files import exclusive
from tests.orchestrator.cli.test_compare import bad, good, save


@pytest.fixture
def runs(tmp_path):
    root = tmp_path / "runs"
    save(root / "monday", good, run_id="1" * 32, started_at=1.0)
    save(root / "tuesday", bad, run_id="2" * 32, started_at=2.0)
    return root


def listed(run_command):
    return [line.split()[2] for line in run_command("list", "runs").out.splitlines()[2:]]


@pytest.mark.parametrize("name", ["monday", "runs/monday", "11111111", "1" * 32])
def test_a_forgotten_run_stays_forgotten_and_keeps_its_folder(run_command, runs, name):
    done = run_command("list", "runs", "--forget", name)
    assert done.code == 0
    assert done.out.splitlines() == ["monday: removed from the history", f"its folder stays: {runs / 'monday'}"]
    assert listed(run_command) == ["tuesday"]
    assert listed(run_command) == ["tuesday"]
    assert (runs / "monday" / "episodes.sqlite").exists()


def test_delete_removes_the_folder(run_command, runs):
    assert run_command("list", "runs", "--forget", "monday", "--delete").out.count(str(runs / "monday")) == 1
    assert not (runs / "monday").exists()
    assert listed(run_command) == ["tuesday"]


def test_a_later_run_in_the_folder_of_a_forgotten_one_is_recorded(run_command, runs):
    run_command("list", "runs", "--forget", "monday")
    save(runs / "monday", good, run_id="3" * 32, started_at=3.0)
    assert listed(run_command) == ["monday", "tuesday"]


def test_a_forgotten_run_comes_back_by_its_import(run_command, runs):
    run_command("export", "runs/monday", "--out", "monday.zip")
    run_command("list", "runs", "--forget", "monday", "--delete")
    assert run_command("import", "monday.zip", "--out", "runs/again").code == 0
    assert listed(run_command) == ["tuesday", "again"]


@pytest.mark.parametrize("name", ["wednesday", "1", "1111111", "%", "."])
def test_a_name_that_might_be_another_runs_is_refused(run_command, runs, name):
    assert f"no run '{name}' in the history" in run_command("list", "runs", "--forget", name, "--delete").refusal
    assert listed(run_command) == ["tuesday", "monday"]


def test_a_run_in_progress_is_refused(run_command, runs):
    listed(run_command)
    with exclusive(runs / "monday" / ".lock", RuntimeError()):
        refused = run_command("list", "runs", "--forget", "monday", "--delete").refusal
        assert "a process is running it; stop it first" in refused
    assert listed(run_command) == ["tuesday", "monday"]


def test_a_folder_that_has_another_run_is_not_removed(run_command, runs):
    listed(run_command)
    save(runs / "monday", good, run_id="3" * 32, started_at=3.0)
    assert "the folder has run 3333" in run_command("list", "runs", "--forget", "monday", "--delete").refusal
    assert read_run(runs / "monday").run_id == "3" * 32


def test_rows_in_the_historys_own_database_need_delete(run_command, runs, tmp_path):
    url = f"sqlite:///{tmp_path / 'shared.sqlite'}"
    shared = read_run(runs / "monday").model_copy(update={"store_url": url})
    with (
        closing(Store.open(url, shared.run_id)) as there,
        closing(Store.open_begun(runs / "monday", read_run(runs / "monday"))) as rows,
    ):
        History(there.database).record(shared, tmp_path / "x" / "monday")
        there.add(list(rows.results()))
    assert "expected --delete" in run_command("list", "runs", "--forget", "monday", "--history", url).refusal
    assert "160 rows in it" in run_command("list", "runs", "--forget", "monday", "--history", url, "--delete").out
    with closing(History.open(url)) as history:
        assert history.runs() == []
        assert history.count_cells("1" * 32) == {}


@pytest.mark.parametrize("options", [(), ("--delete",)], ids=["kept", "deleted"])
def test_a_broken_run_is_forgotten_for_good(run_command, runs, options):
    listed(run_command)
    (runs / "monday" / "run.json").write_text("{")
    assert run_command("list", "runs", "--forget", "monday", *options).code == 0
    assert listed(run_command) == ["tuesday"]
    assert run_command("list", "runs").err == ""
