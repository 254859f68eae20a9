"""The rule of success in a real simulator, from the suite to the row."""

import pytest

from robogauntlet.orchestrator.episodes.episode_runner import EpisodeRunner
from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.suites.episode import Episode, Protocol, SuccessRule


@pytest.mark.simulator
def test_a_goal_that_is_reached_before_a_short_horizon_is_a_success_where_it_counts_once():
    runner = EpisodeRunner({"oracle": PolicySource("oracle")})
    found = {}
    for rule in SuccessRule:
        played = (
            Episode("oracle", "oracle", "pybullet/PandaReach-v3", seed, Protocol(8, success=rule)) for seed in range(5)
        )
        found[rule] = [runner.play_one(episode) for episode in played]
    runner.close()
    once, held = found[SuccessRule.ONCE], found[SuccessRule.HELD]
    assert [row.status for row in once] == ["success"] * 5
    assert [row.success_once for row in held] == [True] * 5
    assert sum(row.status == "success" for row in held) == 1
    assert all(one.steps <= row.steps for one, row in zip(once, held, strict=True))
