"""Tests of results/run_document.py."""

from __future__ import annotations

import json

import pytest

from robogauntlet.results.run_document import RUN_FILE, STORE_FILE, RunError, read_run, shortened, store_url, write_run
from robogauntlet.results.store.episode_store import Store
from tests.errors import one_line_error
from tests.results.synthetic import document


def test_a_written_document_is_read_back(tmp_path):
    run = document(
        instructions={"maniskill/PushCube-v1": "push the cube – ganz sanft"}, skipped={"robosuite": "absent"}
    )
    write_run(tmp_path, run)
    assert read_run(tmp_path) == run
    assert [path.name for path in tmp_path.iterdir()] == [RUN_FILE]


def test_planned_counts_skipped_simulators_too():
    assert document(planned=10, skipped={"robosuite": "absent"}).planned == 80


def test_a_write_that_fails_leaves_the_old_document(tmp_path, monkeypatch):
    run = document()
    write_run(tmp_path, run)

    def full(*_):
        raise OSError("disk full")

    monkeypatch.setattr("pathlib.Path.replace", full)
    with pytest.raises(OSError, match="disk full"):
        write_run(tmp_path, document(name="other"))
    assert read_run(tmp_path) == run
    assert [path.name for path in tmp_path.iterdir()] == [RUN_FILE]


def test_a_folder_without_a_run_is_refused(tmp_path):
    with pytest.raises(RunError, match="it does not exist"):
        read_run(tmp_path / "absent")
    with pytest.raises(RunError, match=r"it has no run\.json"):
        read_run(tmp_path)
    file = tmp_path / "file"
    file.touch()
    with pytest.raises(RunError, match="this is a file"):
        read_run(file)


@pytest.mark.parametrize("name", ["plain", "a?b", "100%41", "a b#c", "über", "a'b\"c"])
def test_the_store_is_in_the_run_folder_whatever_its_name(tmp_path, name):
    folder = tmp_path / name
    folder.mkdir()
    Store.open(store_url(folder, document()), "run-1").close()
    assert (folder / STORE_FILE).is_file()
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_an_address_that_is_given_wins_and_a_database_needs_one(tmp_path):
    hidden = document(store_url="postgresql://reader:***@host/db")
    assert store_url(tmp_path, hidden, "postgresql://reader:secret@host/db") == "postgresql://reader:secret@host/db"
    with pytest.raises(RunError, match=r"its rows are in postgresql.*; give that address with --store"):
        store_url(tmp_path, hidden)


def test_a_plan_that_no_database_can_hold_is_refused(tmp_path):
    content = json.loads(document().model_dump_json())
    content["plan"] = [cell | {"planned": 2**52} for cell in content["plan"]]
    (tmp_path / RUN_FILE).write_text(json.dumps(content))
    with one_line_error(RunError, r"run\.json.*plan"):
        read_run(tmp_path)


def test_a_message_of_any_length_is_stored_shortened(tmp_path):
    reason = shortened("why " * 100_000)
    write_run(tmp_path, document().model_copy(update={"reason": reason}))
    assert read_run(tmp_path).reason == reason


def test_a_document_of_any_size_needs_no_memory(tmp_path):
    with (tmp_path / RUN_FILE).open("wb") as file:
        file.truncate(2**40)
    with one_line_error(RunError, "expected a run document, got more than 268,435,456 bytes"):
        read_run(tmp_path)
