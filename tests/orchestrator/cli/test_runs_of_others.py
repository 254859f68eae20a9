"""A run that came from elsewhere, as a file or as a folder, is data: nothing that its author chose is used."""

import shutil
from contextlib import closing

import pytest

from robogauntlet.policies import catalog
from robogauntlet.results.media_paths import video_path, videos_folder
from robogauntlet.results.record import outcome_row, rows_hash
from robogauntlet.results.run_document import read_run, store_url, write_run
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.exported_run import export_run
from robogauntlet.suites.episode import Cell, Protocol
from robogauntlet.suites.schema import policy_entry
from tests.results.synthetic import document, execute, row, run_folder

RUN_ID = "0123456789abcdef0123456789abcdef"
IMPORTED = "runs/small-01234567"


def played(root, *policies, digest="0" * 16, **changes):
    """The folder of a run of these policies, as its author has it, with an exported file beside it."""
    entries = [policy_entry(one) if isinstance(one, str) else one for one in policies]
    of = [Cell(entry["name"], digest, "null/Reach", Protocol(horizon=20)) for entry in entries[:1]]
    results = [row(cell, seed) for cell in of for seed in range(2)]
    values = {"run_id": RUN_ID, "name": "small", "policies": entries, "tasks": ["null/Reach"]}
    values |= {"rows_hash": rows_hash(map(outcome_row, results)), "command": "touch stolen"}
    run = document(2, of=of, **{**values, **changes})
    folder = run_folder(root / "theirs", run, results, own=False)
    with closing(Store.open(store_url(folder, run), run.run_id)) as store:
        export_run(folder, run, store, root / "run.zip")
    return folder


def popen(marker):
    """A policy that is a command of its author."""
    options = {"callable": "subprocess:Popen", "options": {"args": f"touch {marker}", "shell": True}}
    return {"name": "evil", "kind": "python", "options": options}


VERBS = {
    "verify": ("replay", "--verify", "FOLDER", "--sample", "1"),
    "replay": ("replay", "--run", "FOLDER", "--policy", "evil", "--task", "null/Reach", "--seed", "0"),
}


@pytest.mark.parametrize("verb", VERBS)
def test_a_command_of_the_author_is_not_executed(run_command, tmp_path, verb):
    evil, marker = popen(tmp_path / "stolen"), tmp_path / "stolen"
    folder = played(tmp_path, evil, digest=catalog.digest("python", evil["options"]))
    line = run_command(*(str(folder) if word == "FOLDER" else word for word in VERBS[verb])).refusal
    assert "you did not play this run in this folder" in line
    assert line.endswith("play it from a suite file of yours: --suite FILE")
    assert not marker.exists()


def test_a_suite_of_ones_own_says_which_policies_are_played(run_command, tmp_path):
    folder = played(tmp_path, popen(tmp_path / "stolen"))
    mine = tmp_path / "mine.yaml"
    mine.write_text("name: small\npolicies: [oracle]\ntasks: [null/Reach]\nseeds: {count: 2}\n")
    line = run_command("replay", "--verify", folder, "--suite", mine).refusal
    assert line == "suite 'small' lacks the run's policy 'evil'; name the suite that was played"
    mine.write_text(mine.read_text().replace("[oracle]", "[{name: evil, kind: oracle}]"))
    refused = run_command("replay", "--verify", folder, "--suite", mine).refusal
    assert "policy 'evil' has changed since the run" in refused
    assert not (tmp_path / "stolen").exists()


def test_the_rows_of_a_run_of_others_are_checked_without_playing(run_command, tmp_path):
    done = run_command("replay", "--verify", played(tmp_path, popen(tmp_path / "stolen")), "--sample", "0")
    assert done.code == 0
    assert "as in run.json" in done.out


def test_a_run_of_ones_own_is_played_from_its_document(run_command, tmp_path):
    folder = played(tmp_path, "oracle")
    run_folder(folder, read_run(folder), [])
    assert "policy 'oracle' has changed since the run" in run_command("replay", "--verify", folder).refusal


REFUSED = {
    "run": (("run", "small.yaml", "--out", IMPORTED), "continued"),
    "replay": (("replay", "--run", IMPORTED, *VERBS["replay"][3:], "--suite", "small.yaml"), "played again"),
    "verify": (("replay", "--verify", IMPORTED, "--suite", "small.yaml"), "verified"),
    "verify of rows": (("replay", "--verify", IMPORTED, "--sample", "0"), "verified"),
    "gate": (("compare", "--gate", "theirs", IMPORTED), "a baseline"),
}


@pytest.mark.parametrize(("words", "use"), REFUSED.values(), ids=REFUSED)
def test_an_imported_run_is_rows_and_is_not_played(run_command, tmp_path, words, use):
    evil, marker = popen(tmp_path / "stolen"), tmp_path / "stolen"
    played(tmp_path, evil, digest=catalog.digest("python", evil["options"]))
    assert run_command("import", tmp_path / "run.zip").code == 0
    suite = "name: small\npolicies: [{name: evil, kind: oracle}]\ntasks: [null/Reach]\nseeds: {count: 2}\n"
    (tmp_path / "small.yaml").write_text(suite)
    line = run_command(*words).refusal
    assert line == f"{IMPORTED}: an imported run is not {use}; run its suite file: robogauntlet run SUITE"
    assert not marker.exists()


def test_an_imported_run_is_compared_with_ones_own(run_command, tmp_path):
    played(tmp_path, "oracle")
    assert run_command("import", tmp_path / "run.zip").code == 0
    assert run_command("compare", IMPORTED, "theirs").code == 0


def test_an_import_never_takes_the_place_of_a_run(run_command, tmp_path):
    folder = played(tmp_path, "oracle")
    (tmp_path / "runs").mkdir()
    shutil.move(folder, tmp_path / "runs" / "monday")
    run_folder(tmp_path / "runs" / "monday", read_run(tmp_path / "runs" / "monday"), [])
    before = run_command("list", "runs").out
    line = run_command("import", tmp_path / "run.zip").refusal
    assert line.endswith(f"is in the history already, in {tmp_path}/runs/monday; nothing is imported")
    assert not (tmp_path / IMPORTED).exists()
    assert run_command("list", "runs").out == before


def test_an_import_from_the_future_is_refused(run_command, tmp_path):
    played(tmp_path, "oracle", started_at=7.2e9)
    line = run_command("import", tmp_path / "run.zip").refusal
    assert "expected a start in the past, got 2198-" in line
    assert not (tmp_path / IMPORTED).exists()


def test_an_imported_run_is_no_baseline_and_on_a_leaderboard_only_if_asked_for(run_command, tmp_path):
    played(tmp_path, "oracle")
    assert run_command("import", tmp_path / "run.zip").code == 0
    refused = run_command("compare", "--accept", "small-01234567").refusal
    assert "a run of others is no baseline; run its suite file: robogauntlet run SUITE" in refused
    assert "runs of others count with --imported" in run_command("compare", "--all", "small").refusal
    assert "small-01234567 (imported)" in run_command("compare", "--all", "small", "--imported").out


def test_an_imported_run_says_so(run_command, tmp_path):
    played(tmp_path, "oracle")
    assert run_command("import", tmp_path / "run.zip").code == 0
    folder = tmp_path / IMPORTED
    assert read_run(folder).origin == "imported"
    assert run_command("report", folder).code == 0
    assert "Complete, imported" in (folder / "report.md").read_text()


@pytest.mark.parametrize("form", ["imported", "copied"])
def test_a_command_of_the_author_is_not_shown_to_be_pasted(run_command, tmp_path, form):
    folder = played(tmp_path, "oracle")
    if form == "imported":
        assert run_command("import", tmp_path / "run.zip").code == 0
        folder = tmp_path / IMPORTED
    write_run(folder, read_run(folder).model_copy(update={"media_left_out": 3}))
    assert run_command("report", folder).code == 0
    assert "Not recorded: 3" in (folder / "report.html").read_text()
    assert "touch stolen" not in (folder / "report.html").read_text()
    assert "touch stolen" not in run_command("run", folder).refusal


def test_a_row_of_others_writes_no_file_outside_of_the_run(run_command, tmp_path):
    folder = played(tmp_path, "oracle")
    execute(folder / "episodes.sqlite", "UPDATE episodes SET episode_id = '../../../stolen' WHERE seed = 0")
    mine = tmp_path / "mine.yaml"
    mine.write_text("name: small\npolicies: [oracle]\ntasks: [null/Reach]\nseeds: {count: 2}\n")
    named = ("--policy", "oracle", "--task", "null/Reach", "--seed", 0)
    line = run_command("replay", "--run", folder, *named, "--suite", mine).refusal
    assert line == f"{folder}: the row of episode ../../../stolen is that of another; it is not replayed"
    assert video_path(folder, "../../../stolen").parent == videos_folder(folder)


@pytest.mark.ray
def test_rows_of_others_do_not_become_ones_own_where_their_run_is_continued(run_command, tmp_path):
    suite = tmp_path / "s.yaml"
    suite.write_text("name: small\npolicies: [oracle]\ntasks: [null/Reach]\nseeds: {count: 1}\n")
    assert run_command("run", suite, "--out", "elsewhere/theirs", "--no-media").code == 0
    shutil.copytree(tmp_path / "elsewhere" / "theirs", tmp_path / "runs" / "theirs")
    again = run_command("run", suite, "--out", "runs/theirs", "--no-media")
    assert again.code == 0
    assert "you did not begin this run in this folder" in again.err
    assert "complete, imported" in run_command("list", "runs").out
    assert "is no baseline" in run_command("compare", "--accept", "theirs").refusal
