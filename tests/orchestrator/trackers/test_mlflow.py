"""Logging to MLflow in a database on this machine, which is read by its client."""

import pytest

from robogauntlet.results.run_document import RunStatus
from tests.orchestrator.trackers.runs import gauntlet_log, require, save

require("mlflow", "mlflow", "alembic")


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return tmp_path_factory.mktemp("mlflow")


@pytest.fixture(scope="module")
def logged(place):
    """Logged twice: stopped, then complete."""
    address = f"sqlite:///{place / 'mlflow.db'}"
    for status in (RunStatus.STOPPED, RunStatus.COMPLETE):
        save(place / status / "night", status=status)
        done = gauntlet_log(
            f"{status}/night", "--tracker", "mlflow", "--project", "nights", cwd=place, MLFLOW_TRACKING_URI=address
        )
        assert done.returncode == 0, done.stderr
    return address, done


@pytest.fixture(scope="module")
def runs(logged):
    from mlflow.tracking import MlflowClient

    client = MlflowClient(tracking_uri=logged[0])
    experiment = client.get_experiment_by_name("nights")
    return client.search_runs([experiment.experiment_id])


def test_the_metrics_are_logged(runs):
    metrics = runs[0].data.metrics
    assert metrics["success_rate/p-1/maniskill/PushCube-v1"] == 0.75
    assert metrics["errors/p-1/pybullet/Push/camera-position/3"] == 2
    assert metrics["n/all"] == 76


def test_the_run_has_its_name_tags_and_provenance(runs):
    assert runs[0].info.run_name == "night"
    assert runs[0].data.params["git_commit"] == "abc123"
    assert runs[0].data.params["packages/mani-skill"] == "3.0.1"
    assert {"robogauntlet", "synthetic", "maniskill"} < runs[0].data.tags.keys()


def test_a_run_logged_twice_is_updated(runs):
    assert len(runs) == 1
    assert runs[0].data.tags["robogauntlet/status"] == "complete"
    assert runs[0].info.status == "FINISHED"


def test_the_cells_are_logged_as_a_file(place, runs):
    (path,) = place.glob(f"mlruns/*/{runs[0].info.run_id}/artifacts/cells.csv")
    assert path.read_text().splitlines()[0].startswith("simulator,task,policy")
    assert len(path.read_text().splitlines()) == 5


def test_no_free_text_of_the_run_is_written(place, runs):
    assert b"s3cr3t" not in (place / "mlflow.db").read_bytes()


def test_the_place_of_the_run_is_returned(logged, runs):
    assert logged[1].stdout.strip() == f"logged: {logged[0]}, experiment nights, run {runs[0].info.run_id}"


def test_an_unreachable_server_is_one_line_without_its_login(place, logged):
    done = gauntlet_log(
        *("complete/night", "--tracker", "mlflow"),
        cwd=place,
        MLFLOW_TRACKING_URI="http://me:s3cr3t@localhost:9",
        MLFLOW_HTTP_REQUEST_MAX_RETRIES="0",
    )
    assert done.returncode == 2
    assert "MLflow did not accept the run (MlflowException" in done.stderr.splitlines()[-1]
    assert "s3cr3t" not in done.stderr + done.stdout
