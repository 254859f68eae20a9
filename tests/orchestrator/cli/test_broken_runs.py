"""One broken run costs one run, and a file that is no store stays as it is."""

import json

import pytest

from tests.orchestrator.cli.test_compare import bad, good, save
from tests.processes import GAUNTLET, run_process


@pytest.fixture
def runs(tmp_path):
    root = tmp_path / "runs"
    save(root / "monday", good, run_id="1", started_at=1.0)
    save(root / "tuesday", bad, run_id="2", started_at=86_400.0)
    return root


def break_run(root, name, **changes):
    content = json.loads((root / "monday" / "run.json").read_text())
    (root / name).mkdir()
    (root / name / "run.json").write_text(json.dumps(content | changes))


@pytest.mark.parametrize(
    "verb", [("list", "runs"), ("compare", "--all", "synthetic"), ("compare", "--accept", "monday")], ids=lambda v: v[0]
)
def test_a_broken_run_is_named_and_the_others_are_there(run_command, runs, verb):
    break_run(runs, "far", started_at=1e20)
    break_run(runs, "huge", media_left_out=2**63)
    done = run_command(*verb)
    assert done.code == 0
    named = [line.split()[1] for line in done.err.splitlines()]
    assert named == ["far", "huge"]


def test_the_gate_passes_over_a_broken_run(run_command, runs):
    break_run(runs, "far", started_at=1e20)
    done = run_command("compare", "--gate", "runs/tuesday")
    assert done.code == 1
    assert "tuesday against monday" in done.out


@pytest.mark.parametrize("field", ["started_at", "finished_at", "elapsed_s"])
def test_a_report_of_a_document_out_of_bounds_is_one_line(run_command, runs, field):
    break_run(runs, "far", **{field: 1e20})
    assert field in run_command("report", "runs/far").refusal


@pytest.mark.parametrize("content", [b"", b"x"], ids=["empty", "one byte"])
def test_an_emptied_store_leaves_the_report_as_it_was(run_command, runs, content):
    assert run_command("report", "runs/monday").code == 0
    before = {path.name: path.read_bytes() for path in (runs / "monday").iterdir()}
    (runs / "monday" / "episodes.sqlite").write_bytes(content)
    assert "expected a store, this file is" in run_command("report", "runs/monday").refusal
    after = {path.name: path.read_bytes() for path in (runs / "monday").iterdir()}
    assert after == before | {"episodes.sqlite": content}


@pytest.mark.parametrize("verb", [("list", "runs"), ("serve", "dashboard", "--port", "0")], ids=lambda verb: verb[0])
def test_a_file_that_is_no_history_is_not_turned_into_one(run_command, tmp_path, verb):
    file = tmp_path / "byte"
    file.write_bytes(b"x")
    line = run_command(*verb, "--history", f"sqlite:///{file}").refusal
    assert "expected a store, this file is something else" in line
    assert file.read_bytes() == b"x"


READ_ONLY = 'mount --bind "$0" "$0" && mount -o remount,ro,bind "$0" && exec "$@"'


@pytest.mark.parametrize(
    "verb", [("replay", "--verify", "--sample", "0"), ("export", "--out", "new")], ids=lambda v: v[0]
)
def test_a_store_in_a_read_only_folder_says_what_to_do(runs, tmp_path, verb):
    own_mounts = ["unshare", "--map-root-user", "--mount", "sh", "-c", READ_ONLY, runs]
    if run_process([*own_mounts, "true"]).returncode:
        pytest.skip("this machine lets nobody mount a folder read-only")
    done = run_process([*own_mounts, *GAUNTLET, verb[0], runs / "monday", *verb[1:]], cwd=tmp_path)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1), done.stderr
    assert "expected a store in a place that can be written, which reading takes too; copy it to one" in done.stderr
