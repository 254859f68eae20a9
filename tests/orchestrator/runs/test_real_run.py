"""A run in the three real simulators, and one in which everything dies once."""

import pytest

from robogauntlet.results.run_document import RunStatus
from tests.chaos.campaign import run_campaign
from tests.chaos.suites import NULL, REAL
from tests.orchestrator.runs.playing import play, rows_of

pytestmark = [pytest.mark.ray, pytest.mark.simulator, pytest.mark.usefixtures("ray_here")]
SUITE = REAL.replace("untrained", "random").replace("workers: auto", "workers: 1").replace("count: 4", "count: 2")
FAULTS = ("worker killed", "raylet killed", "scheduler killed")


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory, ray_here):
    """A run with one worker per simulator."""
    folder = tmp_path_factory.mktemp("runs")
    (suite := folder / "suite.yaml").write_text(SUITE)
    return play(suite, folder / "one")


def test_a_run_in_three_simulators_is_complete_and_the_oracle_succeeds(undisturbed):
    assert (undisturbed.document.status, undisturbed.done, undisturbed.document.skipped) == (RunStatus.COMPLETE, 12, {})
    statuses = {(row.simulator, row.policy, row.status) for row in rows_of(undisturbed.folder)}
    simulators = ("maniskill", "pybullet", "robosuite")
    assert statuses == {(s, p, r) for s in simulators for p, r in (("oracle", "success"), ("random", "failure"))}
    assert set(undisturbed.document.render_devices) == set(simulators)


def test_both_policies_of_a_pair_start_from_the_same_state(undisturbed):
    states: dict[str, set[str]] = {}
    for row in rows_of(undisturbed.folder):
        states.setdefault(row.pair_id, set()).add(row.state_hash)
    assert len(states) == 6
    assert all(len(hashes) == 1 for hashes in states.values())


@pytest.mark.nightly
@pytest.mark.slow
def test_the_death_of_worker_ray_and_scheduler_changes_no_row(tmp_path):
    (suite := tmp_path / "suite.yaml").write_text(
        NULL.replace("count: 120", "count: 25").replace("workers: 2", "workers: 1")
    )
    disturbed = run_campaign(suite, tmp_path / "disturbed", 0, faults=FAULTS, gap_s=0.3)
    assert (disturbed.problems, disturbed.starts) == ([], 2)
    assert disturbed.rows_hash == play(suite, tmp_path / "one").document.rows_hash
