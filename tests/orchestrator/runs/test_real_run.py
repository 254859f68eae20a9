"""Runs in the three real simulators: the same rows with one worker and with two, one of which is killed."""

import os
import signal

import pytest

from robogauntlet.orchestrator.runs.progress import Progress
from robogauntlet.results.record import outcome_row
from robogauntlet.results.run_document import RunStatus
from tests.orchestrator.runs.playing import play, rows_of

pytestmark = [pytest.mark.ray, pytest.mark.simulator, pytest.mark.usefixtures("ray_here")]
SUITE = """
name: one-of-each
policies: [oracle, untrained]
tasks: [maniskill/PushCube-v1, pybullet/PandaPickAndPlace-v3, robosuite/Lift]
seeds: {{start: 40, count: 2}}
image_size: 64
render_profile: fast-2
horizon: 48
workers: {workers}
"""


def run(folder, workers, *, progress=Progress):
    suite = folder.parent / f"{folder.name}.yaml"
    suite.write_text(SUITE.format(workers=workers))
    return play(suite, folder, progress=progress)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory, ray_here):
    """A run with one worker per simulator."""
    return run(tmp_path_factory.mktemp("runs") / "one", 1)


def test_a_run_in_three_simulators_is_complete_and_the_oracle_succeeds(undisturbed):
    assert (undisturbed.document.status, undisturbed.done, undisturbed.document.skipped) == (RunStatus.COMPLETE, 12, {})
    statuses = {(row.simulator, row.policy, row.status) for row in rows_of(undisturbed.folder)}
    simulators = ("maniskill", "pybullet", "robosuite")
    assert statuses == {(s, p, r) for s in simulators for p, r in (("oracle", "success"), ("untrained", "failure"))}
    assert set(undisturbed.document.render_devices) == set(simulators)


def test_both_policies_of_a_pair_start_from_the_same_state(undisturbed):
    states: dict[str, set[str]] = {}
    for row in rows_of(undisturbed.folder):
        states.setdefault(row.pair_id, set()).add(row.state_hash)
    assert len(states) == 6
    assert all(len(hashes) == 1 for hashes in states.values())


def test_a_second_worker_per_simulator_and_a_killed_worker_change_no_row(undisturbed, tmp_path):
    killed = []

    class Killing(Progress):
        def on_started(self, simulator, readiness):
            super().on_started(simulator, readiness)
            if not killed and simulator == "robosuite":
                killed.append(readiness.pid)

        def on_results(self, results):
            super().on_results(results)
            if killed and killed[0] and any(result.simulator == "robosuite" for result in results):
                os.kill(killed[0], signal.SIGKILL)
                killed[0] = 0

    outcome = run(tmp_path / "two", 2, progress=Killing)
    assert killed == [0]
    first, second = (sorted(map(outcome_row, rows_of(run.folder))) for run in (undisturbed, outcome))
    assert first == second
    assert outcome.document.rows_hash == undisturbed.document.rows_hash
