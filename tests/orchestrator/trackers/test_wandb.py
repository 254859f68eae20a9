"""Logging to W&B offline, whose files are read."""

import json

import pytest

from robogauntlet.orchestrator.trackers.tracked_run import COLUMNS
from tests.orchestrator.trackers.runs import gauntlet_log_apart, items, require, save, wandb_records

require("wandb", "wandb")


@pytest.fixture(scope="module")
def logged(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wandb")
    save(folder / "night")
    done = gauntlet_log_apart("night", "--tracker", "wandb", "--project", "nights", cwd=folder, WANDB_MODE="offline")
    assert done.returncode == 0, done.stderr
    return folder, done


@pytest.fixture(scope="module")
def records(logged):
    (path,) = logged[0].glob("wandb/offline-run-*/run-f00d.wandb")
    return list(wandb_records(path))


def test_the_metrics_are_logged(records):
    summary = {}
    for record in records:
        summary |= items(record.summary.update) | items(record.history.item)
    assert summary["success_rate/p-1/maniskill/PushCube-v1"] == 0.75
    assert summary["errors/p-1/pybullet/Push/camera-position/3"] == 2
    assert summary["n/all"] == 76


def test_the_run_has_its_name_project_tags_and_provenance(records):
    (run,) = (record.run for record in records if record.HasField("run"))
    assert (run.run_id, run.display_name, run.project) == ("f00d", "night", "nights")
    assert set(run.tags) == {"robogauntlet", "synthetic", "maniskill", "pybullet"}
    config = items(run.config.update)
    assert config["git_commit"] == "abc123"
    assert config["status"] == "stopped"


def test_the_table_of_all_cells_is_logged(logged):
    (path,) = logged[0].glob("wandb/offline-run-*/files/media/table/cells_*.table.json")
    table = json.loads(path.read_text())
    assert table["columns"] == list(COLUMNS)
    assert len(table["data"]) == 4
    assert table["data"][0][:2] == ["maniskill", "maniskill/PushCube-v1"]
    assert table["data"][0][6] == 0.75


def test_no_free_text_of_the_run_and_nothing_of_the_machine_is_written(logged):
    files = [path for path in (logged[0] / "wandb").rglob("*") if path.is_file()]
    assert files
    assert not [path for path in files if b"s3cr3t" in path.read_bytes()]
    assert not {"requirements.txt", "wandb-metadata.json"} & {path.name for path in files}


def test_the_place_of_the_run_is_returned(logged):
    folder, done = logged
    assert done.stdout.startswith(f"logged: upload it with: wandb sync {folder / 'wandb' / 'offline-run-'}")


def test_a_missing_login_is_one_line_with_the_remedy(logged):
    done = gauntlet_log_apart("night", "--tracker", "wandb", cwd=logged[0], WANDB_BASE_URL="http://localhost:9")
    assert done.returncode == 2
    assert "W&B has no login; log in with `wandb login`" in done.stderr
    assert "WANDB_MODE=offline" in done.stderr


def test_a_key_is_not_repeated(logged):
    done = gauntlet_log_apart(
        "night", "--tracker", "wandb", cwd=logged[0], WANDB_BASE_URL="http://localhost:9", WANDB_API_KEY="s3cr3t"
    )
    assert done.returncode == 2
    assert "s3cr3t" not in done.stderr + done.stdout
