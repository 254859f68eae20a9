"""Runs over the three real simulators: the same rows with one worker and two, one of them killed, and in a replay."""

import io
import os
import signal

import pytest
from rich.console import Console

from robogauntlet.orchestrator.runs.plan import make_plan
from robogauntlet.orchestrator.runs.progress import Progress
from robogauntlet.orchestrator.runs.run import RunOptions, run_plan
from robogauntlet.results.record import outcome_row
from robogauntlet.results.run_document import RunStatus
from robogauntlet.results.store.episode_store import Store

pytestmark = [pytest.mark.ray, pytest.mark.simulator, pytest.mark.usefixtures("ray_here")]
SUITE = """
name: one-of-each
policies: [oracle, untrained]
tasks: [maniskill/PushCube-v1, pybullet/PandaPickAndPlace-v3, robosuite/Lift]
seeds: {{start: 40, count: 3}}
image_size: 64
render_profile: fast
horizon: 48
workers: {workers}
"""


def run(folder, workers, *, progress=Progress, media=False):
    suite = folder.parent / f"{folder.name}.yaml"
    suite.write_text(SUITE.format(workers=workers))
    shown = progress(Console(file=io.StringIO(), force_terminal=False))
    return run_plan(make_plan(suite), folder, RunOptions(media=media), shown)


def rows(outcome):
    store = Store.open_file(outcome.folder / "episodes.sqlite", outcome.document.run_id)
    found = sorted(outcome_row(row) for row in store.results())
    store.close()
    return found


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory, ray_here):
    """A run with one worker per simulator, filmed."""
    return run(tmp_path_factory.mktemp("runs") / "one", 1, media=True)


def test_a_run_over_three_simulators_is_complete_and_the_oracle_succeeds(undisturbed):
    assert (undisturbed.document.status, undisturbed.done, undisturbed.document.skipped) == (RunStatus.COMPLETE, 18, {})
    store = Store.open_file(undisturbed.folder / "episodes.sqlite", undisturbed.document.run_id)
    statuses = {(row.simulator, row.policy, row.status) for row in store.results()}
    store.close()
    simulators = ("maniskill", "pybullet", "robosuite")
    assert statuses == {(s, p, r) for s in simulators for p, r in (("oracle", "success"), ("untrained", "failure"))}
    assert set(undisturbed.document.render_devices) == set(simulators)


def test_both_policies_of_a_pair_started_from_the_same_world(undisturbed):
    store = Store.open_file(undisturbed.folder / "episodes.sqlite", undisturbed.document.run_id)
    worlds: dict[str, set[str]] = {}
    for row in store.results():
        worlds.setdefault(row.pair_id, set()).add(row.state_hash)
    store.close()
    assert len(worlds) == 9
    assert all(len(hashes) == 1 for hashes in worlds.values())


def test_filming_replays_episodes_to_the_same_outcome(undisturbed):
    assert undisturbed.warnings == []
    assert len(list((undisturbed.folder / "media/videos").glob("*.mp4"))) == 6
    assert len(list((undisturbed.folder / "media/pictures").glob("*.png"))) == 3
    page = (undisturbed.folder / "report.html").read_text()
    assert page.count("data:video/mp4") == 6


def test_two_workers_per_simulator_and_a_killed_one_change_no_row(undisturbed, tmp_path):
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
    assert rows(outcome) == rows(undisturbed)
    assert outcome.document.rows_hash == undisturbed.document.rows_hash
