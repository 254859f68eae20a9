"""The results of a run as all trackers receive them."""

import dataclasses

import pytest
from hypothesis import given, strategies as st

import robogauntlet
from robogauntlet.orchestrator.trackers.mlflow import _shown
from robogauntlet.orchestrator.trackers.tracked_run import COLUMNS, TrackerError, check_project, tracked_run, usable
from robogauntlet.results.run_document import RunError
from tests.orchestrator.trackers.runs import gauntlet_log, save
from tests.results.synthetic import tables_of


@pytest.fixture(scope="module")
def opened(tmp_path_factory):
    return robogauntlet.open_run(save(tmp_path_factory.mktemp("runs") / "night"))


@pytest.fixture(scope="module")
def tracked(opened):
    return tracked_run(opened.document, opened.tables())


def test_each_policy_and_task_has_its_rate_interval_number_and_errors(tracked):
    metrics = tracked.metrics
    assert metrics["success_rate/p-1/maniskill/PushCube-v1"] == 0.75
    assert 0.5 < metrics["success_rate_low/p-1/maniskill/PushCube-v1"] < 0.75
    assert 0.75 < metrics["success_rate_high/p-1/maniskill/PushCube-v1"] < 0.9
    assert metrics["n/p-1/maniskill/PushCube-v1"] == 20
    assert metrics["errors/p-1/maniskill/PushCube-v1"] == 0


def test_a_perturbed_condition_has_its_own_metrics(tracked):
    metrics = tracked.metrics
    assert metrics["success_rate/p-1/pybullet/Push/camera-position/3"] == pytest.approx(5 / 18)
    assert metrics["errors/p-1/pybullet/Push/camera-position/3"] == 2
    assert metrics["errors/all"] == 4


def test_a_cell_without_episodes_has_no_rate(opened):
    summary = tracked_run(opened.document, tables_of(opened.document, []))
    assert "success_rate/p-1/maniskill/PushCube-v1" not in summary.metrics
    assert summary.metrics["missing/p-1/maniskill/PushCube-v1"] == 20
    assert dict(zip(COLUMNS, summary.rows[0], strict=True))["success_rate"] is None


def test_free_text_of_a_run_is_not_written(tracked):
    assert "s3cr3t" not in repr(dataclasses.asdict(tracked))


def test_the_provenance_is_logged(tracked, opened):
    assert tracked.provenance["git_commit"] == "abc123"
    assert tracked.provenance["packages/mani-skill"] == "3.0.1"
    assert tracked.provenance["policies/p-1"] == opened.document.plan[0].policy_digest
    assert tracked.state["status"] == "stopped"
    assert tracked.tags == ("robogauntlet", "synthetic", "maniskill", "pybullet")


@given(st.text(), st.text())
def test_names_are_escaped_and_stay_different(first, second):
    assert (usable(first) == usable(second)) == (first == second)


@pytest.mark.parametrize("project", ["", "a/b", "a?b", " a", "x" * 129])
def test_a_project_name_that_some_tracker_refuses_is_refused(project):
    with pytest.raises(TrackerError, match="the project's name: expected"):
        check_project(project)


@pytest.mark.parametrize(
    ("address", "shown"),
    [
        ("https://me:s3cr3t@host:5000/x?token=s3cr3t", "https://host:5000"),
        ("postgresql://me:s3cr3t@host/db", "postgresql://host"),
        ("sqlite:///mlflow.db", "sqlite:///mlflow.db"),
    ],
)
def test_an_address_is_shown_without_its_login(address, shown):
    assert _shown(address) == shown


@pytest.mark.parametrize("name", ["wandb", "mlflow"])
def test_a_library_that_is_missing_is_one_line_with_the_command_that_installs_it(tmp_path, name):
    save(tmp_path / "night")
    done = gauntlet_log("night", "--tracker", name, cwd=tmp_path, without=[name])
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert f'is not installed; install it with: pip install "robogauntlet[{name}]"' in done.stderr


def test_a_folder_without_a_run_is_one_line(tmp_path):
    done = gauntlet_log("night", "--tracker", "wandb", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.strip() == "robogauntlet: night: expected a run folder, it does not exist"
    with pytest.raises(RunError):
        robogauntlet.open_run(tmp_path)
