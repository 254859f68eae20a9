"""The shipped experts and merged models in a real simulator; the report shows the cost of merging and routing."""

import json

import pytest

from robogauntlet.orchestrator.registry import find_suite
from robogauntlet.suites.selection import SuiteSelection
from tests.orchestrator.runs.playing import play, rows_of

pytestmark = [pytest.mark.ray, pytest.mark.simulator, pytest.mark.usefixtures("ray_here")]
TASKS = ("pybullet/PandaReach-v3", "pybullet/PandaPush-v3")


@pytest.fixture(scope="module")
def outcome(tmp_path_factory, ray_here):
    folder = tmp_path_factory.mktemp("runs") / "merging"
    return play(find_suite("mergevla"), folder, part=SuiteSelection(tasks=TASKS, seeds=1))


@pytest.fixture(scope="module")
def rows(outcome):
    return rows_of(outcome.folder)


def test_every_episode_is_played(outcome, rows):
    assert len(rows) == outcome.document.planned == len(TASKS) * 5
    assert {row.error for row in rows} == {None}


def test_a_routed_episode_has_the_scores_of_all_experts_a_choice_and_a_latency(rows):
    for row in rows:
        if row.policy == "experts":
            assert row.inferred_task is None
            continue
        scores = json.loads(row.routing_scores)
        assert len(scores) == 9
        assert row.inferred_task == max(scores, key=scores.get)
        assert row.routing_s > 0 or row.policy == "merged-oracle-routed"


def test_a_correctly_routed_episode_is_played_like_the_oracle_routed_one(rows):
    oracle_routed = {row.pair_id: row for row in rows if row.policy == "merged-oracle-routed"}
    correct = [row for row in rows if row.policy.startswith("merged") and row.inferred_task == row.task]
    assert correct
    for row in correct:
        assert row.actions_hash == oracle_routed[row.pair_id].actions_hash
        assert row.final_state_hash == oracle_routed[row.pair_id].final_state_hash


def test_the_report_compares_experts_with_oracle_routed_and_routed_models(outcome):
    merging = outcome.report.data["merging"]
    assert merging is not None
    assert "Merging and routing" in (outcome.folder / "report.html").read_text()
