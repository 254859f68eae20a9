"""Tests of results/store/run_archive.py: a run as one file."""

import os
from contextlib import closing

import pytest

from robogauntlet.results.record import outcome_row, rows_hash
from robogauntlet.results.run_document import RunError, RunStatus, read_run, store_url
from robogauntlet.results.store.arriving import arriving_folder
from robogauntlet.results.store.database import StoreError
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.limited_reader import Copier
from robogauntlet.results.store.run_archive import export_run, import_run
from robogauntlet.results.store.run_history import History
from tests.errors import one_line_error
from tests.results.synthetic import document, execute, rows, run_folder

RUN_ID = "0123456789abcdef0123456789abcdef"
RESULTS = rows(planned=4, errors=1)


@pytest.fixture
def exported(tmp_path):
    run = document(4, run_id=RUN_ID, rows_hash=rows_hash(map(outcome_row, RESULTS)))
    folder = run_folder(tmp_path / "runs" / "night", run, RESULTS)
    file = tmp_path / "night.robogauntlet"
    with closing(Store.open(store_url(folder, run), run.run_id)) as store:
        assert export_run(run, store, file) == len(RESULTS)
    return file


def stored(folder):
    run = read_run(folder)
    with closing(Store.open(store_url(folder, run), run.run_id)) as store:
        return sorted(store.results(), key=lambda r: r.episode_id)


def test_a_run_comes_back_as_it_was(exported, tmp_path):
    folder, run = import_run(exported, tmp_path / "there")
    assert read_run(folder) == run
    assert run == read_run(tmp_path / "runs" / "night").model_copy(update={"origin": "imported"})
    assert stored(folder) == sorted(RESULTS, key=lambda r: r.episode_id)
    assert [path.name for path in (tmp_path / "there").iterdir()] == [folder.name]


def test_an_export_is_one_file_and_is_not_changed_by_an_import(exported, tmp_path):
    before = exported.read_bytes()
    import_run(exported, tmp_path / "there")
    assert exported.read_bytes() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["night.robogauntlet", "runs", "there"]


def test_rows_may_go_into_a_store_of_many_runs(exported, tmp_path):
    shared = f"sqlite:///{tmp_path / 'shared.sqlite'}"
    folder, run = import_run(exported, tmp_path / "there", store=shared)
    assert sorted(p.name for p in folder.iterdir()) == ["run.json"]
    with closing(History.open(shared)) as history:
        assert history.find(run.run_id).counts.done == len(RESULTS)


def test_existing_runs_and_files_are_not_overwritten(exported, tmp_path):
    import_run(exported, tmp_path / "there", name="one")
    with pytest.raises(RunError, match="there is one already"):
        import_run(exported, tmp_path / "there", name="one")
    store = Store.open_file(tmp_path / "any.sqlite", "run-1")
    with closing(store), pytest.raises(RunError, match="there is one already"):
        export_run(document(), store, exported)


def test_changed_rows_are_refused_and_leave_nothing(exported, tmp_path):
    execute(exported, "UPDATE episodes SET status = 'success' WHERE status = 'failure'")
    with pytest.raises(RunError, match="it was changed"):
        import_run(exported, tmp_path / "there")
    assert not (tmp_path / "there").exists()


DAMAGE = {
    "text": lambda file: file.write_text("name: something else\n"),
    "cut": lambda file: file.write_bytes(file.read_bytes()[: file.stat().st_size // 2]),
    "empty": lambda file: file.write_bytes(b""),
    "no run": lambda file: execute(file, "DELETE FROM cells", "DELETE FROM runs"),
    "another program's": lambda file: [file.unlink(), execute(file, "CREATE TABLE runs (x)")],
    "newer": lambda file: execute(file, "UPDATE robogauntlet_schema SET version = 99"),
}


@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE)
def test_a_damaged_export_is_an_error_of_one_line_and_leaves_nothing(exported, tmp_path, damage):
    damage(exported)
    with one_line_error((RunError, StoreError), r"night\.robogauntlet"):
        import_run(exported, tmp_path / "there")
    assert not (tmp_path / "there").exists()


@pytest.mark.parametrize("run_id", ["../up", "run-1", "0" * 31, "0" * 33, "A" * 32, "x" * 499])
def test_a_run_id_that_this_program_does_not_make_is_refused(tmp_path, run_id):
    run = document(4, run_id=run_id, status=RunStatus.INTERRUPTED)
    with closing(Store.open_file(tmp_path / "x.sqlite", run.run_id)) as store:
        export_run(run, store, tmp_path / "x.robogauntlet")
    (tmp_path / "there").mkdir()
    with one_line_error(RunError, "its run id is not one of this program"):
        Copier(tmp_path / "x.robogauntlet", tmp_path / "there")
    assert list((tmp_path / "there").iterdir()) == []


def test_an_import_that_fails_leaves_no_rows_in_a_store_of_many_runs(exported, tmp_path):
    shared = f"sqlite:///{tmp_path / 'shared.sqlite'}"
    execute(exported, "UPDATE episodes SET steps = steps + 1")
    with pytest.raises(RunError, match="it was changed"):
        import_run(exported, tmp_path / "there", store=shared)
    with closing(Store.open(shared, RUN_ID)) as store:
        assert not store.knows_run()
    assert not (tmp_path / "there").exists()


def test_rows_of_a_run_that_a_store_has_are_left_alone(exported, tmp_path):
    shared = f"sqlite:///{tmp_path / 'shared.sqlite'}"
    import_run(exported, tmp_path / "one", store=shared)
    with pytest.raises(RunError, match=f"run {RUN_ID} is there already"):
        import_run(exported, tmp_path / "two", store=shared)
    with closing(Store.open(shared, RUN_ID)) as store:
        assert len(list(store.results())) == len(RESULTS)


def test_what_dead_processes_left_is_removed_and_what_others_hold_is_not(exported, tmp_path):
    root = tmp_path / "there"
    (root / ".arriving-dead").mkdir(parents=True)
    (root / ".arriving-dead" / "body").write_bytes(b"half of a run")
    with arriving_folder(root) as alive:
        for folder in root.glob(".arriving-*"):
            os.utime(folder, (1.0, 1.0))
        (root / ".arriving-young").mkdir()
        import_run(exported, root)
        assert {path.name for path in root.glob(".arriving-*")} == {alive.name, ".arriving-young"}
