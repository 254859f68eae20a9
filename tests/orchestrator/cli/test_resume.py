"""Continuing a run from its folder."""

import pytest

from robogauntlet.results.run_document import RunArguments, read_run, write_run
from robogauntlet.results.run_owner import is_own
from robogauntlet.results.store.database import file_url
from robogauntlet.results.store.run_history import History
from tests.orchestrator.runs.playing import rows_of
from tests.results.synthetic import document, run_folder

SUITE = "name: s\npolicies: [oracle, zero]\ntasks: [null/Raise, null/Reach]\nseeds: {count: 8}\nerror_tolerance: 1\n"
PART = ("--policy", "oracle", "--task", "null/Raise", "--seeds", "8", "--workers", "1", "--success", "once")


@pytest.fixture
def begun(run_command, tmp_path, monkeypatch):
    """A run of a part of a suite, with errors, a store and a history elsewhere."""
    (tmp_path / "s.yaml").write_text(SUITE)
    store, history = file_url(tmp_path / "rows.sqlite"), file_url(tmp_path / "all.sqlite")
    line = ("run", "s.yaml", *PART, "--store", store, "--history", history, "--retry-errors", "--out", "run")
    done = run_command(*line, "--no-media")
    assert done.code == 0, done.err
    (tmp_path / "s.yaml").unlink()
    return store, history


@pytest.mark.ray
@pytest.mark.usefixtures("ray_here")
def test_a_run_is_continued_as_it_was_begun_even_without_its_suite_file(run_command, begun, tmp_path):
    store, history = begun
    before = read_run(tmp_path / "run")
    assert before.command == "robogauntlet resume run"
    played = {row.seed: row.started_at for row in rows_of(tmp_path / "run", store)}
    done = run_command("resume", "run")
    assert done.code == 0, done.err
    assert "continuing: 6 of 8 episodes already done" in done.out  # the two errors are played again
    after = read_run(tmp_path / "run")
    again = {row.seed for row in rows_of(tmp_path / "run", store) if row.started_at != played[row.seed]}
    assert again == {0, 7}
    assert (after.rows_hash, after.arguments) == (before.rows_hash, before.arguments)
    assert after.finished_at > before.finished_at
    recorded = History.open(history)
    assert recorded.document(after.run_id) == after
    recorded.close()
    assert not (tmp_path / "history.sqlite").exists()


@pytest.fixture
def folder(run_command, tmp_path):
    """A folder of a run that nobody began here."""
    from tests.orchestrator.cli.test_runs_of_others import played

    return played(tmp_path, "oracle")


def test_a_run_of_others_is_not_continued(run_command, folder):
    line = run_command("resume", folder).refusal
    assert "you did not begin this run in this folder" in line
    assert f"robogauntlet run FILE --out {folder}" in line


@pytest.fixture
def own(monkeypatch):
    """Every folder is one's own."""
    from robogauntlet.orchestrator.cli import resume

    monkeypatch.setattr(resume, "is_own", lambda folder, document: True)


@pytest.mark.usefixtures("own")
def test_a_run_of_another_command_names_it(run_command, folder):
    write_run(folder, read_run(folder).model_copy(update={"command": "robogauntlet search checkpoint --good a"}))
    assert "continue it with: robogauntlet search checkpoint --good a" in run_command("resume", folder).refusal
    write_run(folder, read_run(folder).model_copy(update={"command": None}))
    assert "it was begun from Python" in run_command("resume", folder).refusal


@pytest.mark.usefixtures("own")
@pytest.mark.parametrize("option", ["store", "history"])
def test_an_address_with_a_password_has_to_be_given_again(run_command, folder, option):
    url, document = "postgresql+psycopg://me:***@host/runs", read_run(folder)
    given = RunArguments(history=url if option == "history" else None)
    address = url if option == "store" else None
    write_run(folder, document.model_copy(update={"arguments": given, "store_url": address}))
    line = run_command("resume", folder).refusal
    assert line.endswith(f"its {option} is {url}; give that address with --{option}")


def test_what_a_run_was_given_belongs_to_its_mark(tmp_path):
    folder = run_folder(tmp_path / "run", document(2), [])
    own = read_run(folder)
    assert is_own(folder, own)
    assert not is_own(folder, own.model_copy(update={"arguments": RunArguments(policies=("python:evil:f",))}))
    assert not is_own(folder, own.model_copy(update={"suite_text": "name: other"}))
