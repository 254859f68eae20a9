"""Which run folders this user played."""

import shutil

import pytest

from robogauntlet.results.run_document import RunDocument
from robogauntlet.results.run_owner import KEY_FILE, MARK_FILE, is_own, mark_as_own
from tests.results.synthetic import document, run_folder


@pytest.fixture
def state(tmp_path, monkeypatch):
    """The folder of the user's state."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path / "state" / "robogauntlet"


def with_policy(**options) -> RunDocument:
    entry = {"name": "p", "kind": "python", "options": {"callable": "mine:act", **options}}
    return document(policies=[entry])


def test_a_run_is_own_where_it_was_played(state, tmp_path):
    run = with_policy()
    folder = run_folder(tmp_path / "run", run, [], own=False)
    assert not is_own(folder, run)
    mark_as_own(folder, run)
    assert is_own(folder, run)
    assert is_own(folder, RunDocument.model_validate_json(run.model_dump_json()))
    assert (state / KEY_FILE).stat().st_mode & 0o777 == 0o600


def test_a_copy_of_a_run_is_not_own(state, tmp_path):
    run = with_policy()
    shutil.copytree(run_folder(tmp_path / "run", run, []), tmp_path / "copy")
    assert not is_own(tmp_path / "copy", run)


def test_other_policies_in_the_document_are_not_own(state, tmp_path):
    folder = run_folder(tmp_path / "run", with_policy(), [])
    assert not is_own(folder, with_policy(callable="subprocess:getoutput"))


def test_an_imported_run_is_not_own_whatever_its_mark(state, tmp_path):
    run = with_policy().model_copy(update={"origin": "imported"})
    folder = run_folder(tmp_path / "run", run, [])
    assert not is_own(folder, run)


def test_another_user_s_mark_is_none(state, tmp_path, monkeypatch):
    folder = run_folder(tmp_path / "run", with_policy(), [])
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "other"))
    assert not is_own(folder, with_policy())
    mark_as_own(run_folder(tmp_path / "second", with_policy(), []), with_policy())
    assert not is_own(folder, with_policy())


def test_a_key_that_others_can_read_proves_nothing(state, tmp_path):
    folder = run_folder(tmp_path / "run", with_policy(), [])
    (state / KEY_FILE).chmod(0o644)
    assert not is_own(folder, with_policy())


def test_a_run_is_played_unmarked_where_no_key_can_be_kept(state, tmp_path):
    state.parent.write_text("a file, not a folder")
    folder = run_folder(tmp_path / "run", with_policy(), [])
    assert not (folder / MARK_FILE).exists()
    assert not is_own(folder, with_policy())
