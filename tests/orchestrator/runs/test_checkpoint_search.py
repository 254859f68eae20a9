"""Searches of checkpoints: rounds, remaining work and results, of simulated outcomes."""

import numpy as np
import pytest

from robogauntlet.orchestrator.runs.adaptive_stopping import key_of
from robogauntlet.orchestrator.runs.checkpoint_search import CheckpointSearch
from tests.results.synthetic import cells

NAMES = tuple("abcdefgh")
TASKS = ("maniskill/PushCube-v1", "robosuite/Lift", "robosuite/Stack")
RATES = (0.95, 0.95, 0.95, 0.95, 0.95, 0.3, 0.3, 0.3)
SEEDS = 100


class Simulated:
    """Plays rounds of a search."""

    def __init__(self, rates=RATES, tasks=TASKS, seeds=SEEDS):
        names = NAMES[: len(rates)]
        self.cells = cells(names, tasks)
        draws = np.random.default_rng(0).random((len(tasks), SEEDS))
        self.wins = {cell: draws[tasks.index(cell.task)] < rates[names.index(cell.policy)] for cell in self.cells}
        self.lines, self.rounds, self.outcomes = [], [], {}
        self.search = CheckpointSearch({f"checkpoint-{name}": name for name in names}, seeds, self.lines.append)

    def play(self, rounds=10_000, status=None):
        for _ in range(rounds):
            self.state = self.search(self.cells, self.outcomes)
            if not self.state.work:
                break
            self.rounds.append(self.state.work)
            for cell, seeds in self.state.work:
                played = self.outcomes.setdefault(key_of(cell), {})
                assert not played.keys() & set(seeds)
                played |= {seed: status or ("success" if self.wins[cell][seed] else "failure") for seed in seeds}
        return self.search.result

    @property
    def episodes(self):
        return sum(map(len, self.outcomes.values()))


def test_the_first_worse_checkpoint_is_found_with_a_fraction_of_the_episodes():
    simulated = Simulated()
    found = simulated.play()
    assert (found.first_worse, found.last_good) == ("checkpoint-f", "checkpoint-e")
    assert found.candidates == ("checkpoint-f",)
    assert found.confidence == 0.95
    assert found.episodes == simulated.episodes == sum(simulated.state.planned.values())
    assert found.episodes < found.all_episodes / 10
    assert found.all_episodes == len(NAMES) * len(TASKS) * SEEDS
    answers = {one.policy: one.is_worse for one in found.checkpoints}
    assert (answers["a"], answers["e"], answers["f"], answers["h"]) == (False, False, True, True)
    assert len(simulated.lines) == len(simulated.rounds)
    assert simulated.lines[0].startswith(
        "is checkpoint-h worse? checkpoint-h not played, checkpoint-a not played; e-value"
    )


def test_a_round_plays_all_tasks_on_the_same_seeds():
    simulated = Simulated()
    simulated.play()
    for work in simulated.rounds:
        assert len({tuple(seeds) for _, seeds in work}) == 1
        assert {cell.task for cell, _ in work} == {*TASKS}
    assert {cell.policy for cell, _ in simulated.rounds[0]} == {"a", "h"}


@pytest.mark.parametrize("rounds", [1, 2, 3, 5])
def test_a_search_that_goes_on_plays_what_it_would_have_played(rounds):
    whole, halves = Simulated(), Simulated()
    expected = whole.play()
    halves.play(rounds)
    halves.state = halves.search(halves.cells, halves.outcomes)
    cell, seeds = halves.state.work[0]  # the next round was interrupted
    halves.outcomes.setdefault(key_of(cell), {})[seeds[-1]] = "success" if halves.wins[cell][seeds[-1]] else "failure"
    halves.search = CheckpointSearch({f"checkpoint-{name}": name for name in NAMES}, SEEDS, print)
    assert halves.play() == expected
    assert halves.outcomes == whole.outcomes


def test_without_checkpoints_between_the_ends_are_compared():
    found = Simulated(rates=(0.9, 0.3)).play()
    assert (found.first_worse, found.last_good) == ("checkpoint-b", "checkpoint-a")


@pytest.mark.parametrize(
    ("rates", "says"), [((0.8, 0.5, 0.8), "not shown to be worse"), ((0.3, 0.5, 0.9), "shown not to be worse")]
)
def test_ends_that_do_not_differ_are_no_result(rates, says):
    simulated = Simulated(rates, seeds=50)
    assert simulated.play() is None
    assert f"the ends do not differ: checkpoint-c is {says} than checkpoint-a (checkpoint-c " in simulated.search.alike
    assert {cell.policy for work in simulated.rounds for cell, _ in work} == {"a", "c"}


def test_a_checkpoint_that_lost_half_leaves_a_range():
    simulated = Simulated((1.0, 1.0, 0.5, 0.0), tasks=TASKS[:1])
    simulated.wins |= {cell: np.arange(SEEDS) % 2 == 0 for cell in simulated.cells if cell.policy == "c"}
    simulated.wins |= {cell: np.arange(SEEDS) % 2 == 1 for cell in simulated.cells if cell.policy == "b"}
    found = simulated.play()
    assert (found.first_worse, found.last_good) == (None, "checkpoint-a")
    assert found.candidates == ("checkpoint-b", "checkpoint-c", "checkpoint-d")
    assert max(simulated.state.planned.values()) == SEEDS


def test_a_checkpoint_of_which_no_episode_can_be_played_ends_the_search():
    simulated = Simulated()
    assert simulated.play(status="error") is None
    assert (simulated.search.unplayable, simulated.search.alike, len(simulated.rounds)) == ("checkpoint-a", None, 1)
