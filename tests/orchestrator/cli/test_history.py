"""`robogauntlet list runs`, `compare --all`, `compare --accept`, `export` and `import`."""

import os
import sqlite3

import pytest

from robogauntlet.results.run_document import RunStatus
from robogauntlet.results.store.schema import VERSION
from tests.orchestrator.cli.test_compare import bad, good, save
from tests.results.synthetic import cells, document, row, run_folder


@pytest.fixture
def runs(tmp_path):
    root = tmp_path / "runs"
    save(root / "monday", good, run_id="1" * 32, started_at=1.0)
    save(root / "tuesday", bad, run_id="2", started_at=86_400.0)
    save(root / "other", good, run_id="3", started_at=2 * 86_400.0, name="another")
    save(root / "half", bad, run_id="4", started_at=3 * 86_400.0, status=RunStatus.INTERRUPTED)
    return root


def test_run_folders_are_listed_the_newest_first(run_command, runs):
    result = run_command("list", "runs")
    assert result.code == 0
    names = [line.split()[2] for line in result.out.splitlines()[2:]]
    assert names == ["half", "other", "tuesday", "monday"]
    assert [line.split()[2] for line in run_command("list", "runs", "--suite", "another").out.splitlines()[2:]] == [
        "other"
    ]


def test_a_run_of_several_policies_has_no_rate_in_the_list(run_command, runs):
    save_one = cells(("p",), ("maniskill/A",))
    results = [row(cell, seed) for cell in save_one for seed in range(40)]
    run_folder(runs / "one", document(40, save_one, run_id="5", started_at=5 * 86_400.0), results)
    lines = run_command("list", "runs").out.splitlines()[2:]
    assert "100 % [91, 100]" in lines[0]
    assert all("2 policies" in line and " % [" not in line for line in lines[1:])


def test_a_policys_history_has_intervals_and_verdicts(run_command, runs):
    assert run_command("compare", "--gate", "runs/tuesday").code == 1
    result = run_command("list", "runs", "p", "--suite", "synthetic")
    lines = result.out.splitlines()
    assert "75 %  [65, 83]" in lines[2]
    assert "▼ regressed" in lines[3]
    assert "▇▅▅  success" in result.out


def test_a_worse_run_is_no_baseline_until_it_is_accepted(run_command, runs):
    assert run_command("compare", "--gate", "runs/tuesday").code == 1
    save(runs / "wednesday", bad, run_id="5", started_at=4 * 86_400.0)
    assert "wednesday against monday" in run_command("compare", "--gate", "runs/wednesday").out
    assert run_command("compare", "--accept", "tuesday").code == 0
    result = run_command("compare", "--gate", "runs/wednesday")
    assert (result.code, "wednesday against tuesday" in result.out) == (0, True)


def test_a_folders_name_comes_before_the_beginning_of_an_id(run_command, runs):
    save(runs / "thursday", good, run_id="mondaylike", started_at=5 * 86_400.0)
    assert run_command("compare", "--accept", "runs/monday").out.startswith("monday: later runs")


def test_the_leaderboard_gives_letters_and_no_ranks(run_command, runs):
    result = run_command("compare", "--all", "synthetic")
    assert result.code == 0
    rows = {line.split()[0]: line.split()[2] for line in result.out.splitlines()[2:4]}
    assert rows == {"q": "a", "p": "b"}


def test_a_run_is_exported_and_imported_as_one_file(run_command, runs, tmp_path):
    assert run_command("export", "runs/monday").out == "160 episodes into monday.zip\n"
    history = f"sqlite:///{tmp_path}/elsewhere/history.sqlite"
    result = run_command("import", "monday.zip", "--out", "elsewhere/monday", "--history", history)
    assert result.code == 0
    assert (tmp_path / "elsewhere" / "monday" / "report.html").exists()
    assert "complete, imported" in run_command("list", "runs", "--history", history).out


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_exports_overwrite_nothing(run_command, runs, tmp_path, form):
    typed = ("export", "runs/monday", "--format", form)
    assert run_command(*typed).out == f"160 episodes into monday.{form}\n"
    assert (tmp_path / f"monday.{form}").stat().st_size
    assert "this one exists" in run_command(*typed).refusal


@pytest.mark.parametrize("form", ["run", "csv", "parquet"])
def test_an_export_that_was_killed_leaves_nothing_after_the_next(run_command, runs, tmp_path, form):
    left = tmp_path / ".arriving-killed"
    left.mkdir()
    (left / "monday.csv").write_text("half")
    os.utime(left, (0, 0))
    assert run_command("export", "runs/monday", "--format", form, "--out", "made").code == 0
    assert {path.name for path in tmp_path.iterdir()} == {"runs", "made"}


@pytest.mark.parametrize("form", ["run", "csv", "parquet"])
def test_an_export_that_fails_leaves_nothing(run_command, runs, tmp_path, form):
    (runs / "monday" / "episodes.sqlite").unlink()
    assert "there is no such file" in run_command("export", "runs/monday", "--format", form, "--out", "made").refusal
    assert {path.name for path in tmp_path.iterdir()} == {"runs"}


@pytest.mark.parametrize(
    ("typed", "words"),
    [
        (("list", "runs", "pp"), "no run with a policy 'pp'; did you mean 'p'?"),
        (("list", "runs", "--suite", "synthetc"), "no run of a suite 'synthetc'; did you mean 'synthetic'?"),
        (("list", "runs", "p", "--task", "nowhere"), "no run with a policy 'p' on 'nowhere'"),
        (("list", "runs", "--history", "mysql://x/y"), "expected an sqlite or postgresql URL, got mysql"),
        (("list", "runs", "--history", "postgresql+psycopg://me:secret@127.0.0.1:1/x"), "127.0.0.1"),
        (("compare", "--all", "nothing"), "no run of a suite 'nothing'"),
        (("compare", "--accept", "nothing"), "no run 'nothing' in the history"),
        (("export", "nothing"), "expected a run folder, it does not exist"),
        (
            ("export", "runs/monday", "--format", "csv", "--out", "no/such.csv"),
            "no/such.csv: expected a file in an existing folder",
        ),
        (("export", "runs/monday", "--store", "sqlite:///mistyped.sqlite"), "the run in runs/monday, there is no such"),
        (("import", "nothing"), "expected an exported run"),
        (("import", "runs/monday/run.json"), "this is something else"),
    ],
)
def test_a_mistake_is_one_line(run_command, runs, typed, words):
    line = run_command(*typed).refusal
    assert words in line
    assert "secret" not in line


def test_a_history_of_a_newer_version_is_refused_and_unchanged(run_command, runs):
    run_command("list", "runs")
    with sqlite3.connect(runs / "history.sqlite") as connection:
        connection.execute("UPDATE robogauntlet_schema SET version = 99")
    connection.close()
    before = (runs / "history.sqlite").read_bytes()
    assert f"expected a store of version {VERSION}, got version 99" in run_command("list", "runs").refusal
    assert (runs / "history.sqlite").read_bytes() == before


def test_a_check_of_rows_alone_does_not_say_that_episodes_were_replayed(run_command, runs):
    assert run_command("replay", "--verify", "runs/monday", "--sample", "0").out.endswith(
        "no episode of 160 replayed\n"
    )
