"""The search for worst cases finds known boundaries of simulated policies, and claims no more than it confirms."""

import math

import numpy as np
import pytest

from robogauntlet.results.report.worst_cases import verdict
from robogauntlet.results.statistics.boundary import BoundaryEstimate, Trials, excess, is_below
from robogauntlet.results.statistics.worst_case import (
    FIRST_CONFIRMATION_SEED,
    LEAST_STATES,
    MOST_EPISODES,
    SearchSpace,
    least_budget,
    search_worst_cases,
)
from robogauntlet.suites.episode import FIRST_TRAINING_SEED
from tests.jobs import mostly_nightly

CLEAN = 0.95
WIDTH = 0.35
"""Width of the logistic fall of success, in severities of the weakest axis."""


class Policy:
    """Success falls as a logistic function of the sum of severity / threshold."""

    def __init__(self, clean=CLEAN, width=WIDTH, **thresholds):
        self.clean, self.thresholds = clean, thresholds
        self._width = width / min(thresholds.values())

    def success(self, point):
        return self.clean * self._logistic(self._load(point)) / self._logistic(0.0)

    def _load(self, point):
        return sum(severity / self.thresholds[axis] for axis, severity in point)

    def _logistic(self, load):
        return 1 / (1 + math.exp((load - 1) / self._width))

    def load_at_half(self):
        half = self._logistic(0.0) / 2
        return 1 + self._width * math.log((1 - half) / half)

    def smallest(self):
        """Norm of the smallest disturbance that halves success."""
        return self.load_at_half() / math.hypot(*(1 / one for one in self.thresholds.values()))

    def alone(self, axis):
        return self.load_at_half() * self.thresholds[axis]


def run(policy, budget, seed=0, rounds=None, **space):
    """Search against a simulated policy."""
    rng = np.random.default_rng([seed, budget])
    search = search_worst_cases(SearchSpace(tuple(policy.thresholds), **space), budget, seed=seed)
    asked = next(search)
    try:
        while True:
            if rounds is not None:
                rounds.append(asked)
            n = len(asked.seeds)
            asked = search.send({p: Trials(int(rng.binomial(n, policy.success(p))), n) for p in asked.points})
    except StopIteration as end:
        return end.value


def smallest_found(found):
    return min((one.boundary.value for one in (*found.axes, found.combined) if one and one.breaks), default=math.inf)


FOUND = {
    "two": (Policy(a=2.0, b=3.0), 200, 0.85),
    "two, more episodes": (Policy(a=2.0, b=3.0), 400, 0.95),
    "low clean rate": (Policy(clean=0.7, a=2.0, b=3.0), 300, 0.8),
    "slow fall": (Policy(width=0.7, a=2.5, b=3.0), 400, 0.85),
    "one of two": (Policy(a=2.5, b=12.0), 200, 0.85),
    "four": (Policy(a=2.0, b=3.0, c=4.0, d=20.0), 400, 0.85),
}
"""Simulated policies, a budget, and the share of searches that find the boundary."""


@pytest.mark.parametrize("case", mostly_nightly(FOUND, ["two", "one of two", "low clean rate"]))
def test_the_smallest_disturbance_is_found_within_half_a_severity(case):
    policy, budget, share = FOUND[case]
    found = [smallest_found(run(policy, budget, seed)) for seed in range(40)]
    near = [abs(value - policy.smallest()) <= 0.5 for value in found]
    assert np.mean(near) >= share


@pytest.mark.parametrize("budget", [100, 200])
def test_the_boundary_of_an_axis_alone_is_found_within_half_a_severity(budget):
    policy = Policy(a=2.6)
    found = [run(policy, budget, seed).axes[0].boundary.value for seed in range(40)]
    assert np.mean([abs(value - policy.alone("a")) <= 0.5 for value in found]) >= 0.95


def test_an_axis_that_breaks_nothing_has_its_boundary_beyond_the_largest_severity():
    policy = Policy(width=0.5, a=30.0)
    found = [run(policy, 100, seed).axes[0] for seed in range(20)]
    assert all(one.boundary.value is None and not one.breaks and one.point == (("a", 5.0),) for one in found)
    assert np.mean([one.is_confirmed for one in found]) > 0.9


def test_four_of_five_disturbances_that_are_proposed_are_confirmed():
    """`studies/worst_cases` has 1,000 searches. What has too few episodes for a likely confirmation is none of them."""
    found = [run(Policy(a=2.0, b=3.0), 200, seed) for seed in range(40)]
    claims = [one for case in found for one in (*case.axes, case.combined) if one and one.breaks]
    proposed = [one.is_confirmed for one in claims if one.is_proposed]
    assert np.mean(proposed) >= 0.8
    assert len(proposed) > len(claims) / 2
    few = [one for one in claims if not one.is_proposed]
    assert {one.norm for one in few} == {5.0}
    assert {verdict(one) for one in few} == {"breaks", "too few episodes to tell"}


def test_chance_at_the_boundary_is_not_called_confirmed():
    rng = np.random.default_rng(0)
    won, clean = rng.binomial(40, 0.45, 4000), rng.binomial(40, 0.9, 4000)
    wrong = [is_below(Trials(int(a), 40), Trials(int(b), 40), 0.5) for a, b in zip(won, clean, strict=True)]
    assert np.mean(wrong) <= 0.04


def test_an_interaction_beyond_the_sum_is_found_in_a_pair():
    class Together(Policy):
        def _load(self, point):
            severities = dict(point)
            return super()._load(point) + severities.get("a", 0) * severities.get("b", 0) / 4

    policy = Together(a=20.0, b=20.0, c=20.0)
    found = [run(policy, 400, seed) for seed in range(20)]
    pairs = [one.combined for one in found if one.combined]
    assert len(pairs) >= 15
    assert all({"a", "b"} <= {axis for axis, _ in one.point} for one in pairs)
    assert all(one.axes[0].boundary.value is None for one in found)


@pytest.mark.parametrize(("count", "budget"), [(1, 40), (2, 100), (3, 250), (18, 420), (18, 5000)])
def test_the_budget_is_kept_and_no_seed_of_the_search_confirms(count, budget):
    rounds = []
    policy = Policy(**{f"axis{n}": 2.0 + n for n in range(count)})
    assert budget >= least_budget(count)
    found = run(policy, budget, rounds=rounds)
    played = [(point, seed) for one in rounds for point in one.points for seed in one.seeds]
    assert 0.9 * budget <= len(played) == found.episodes <= budget
    assert len(set(played)) == len(played)
    confirming = [seed for one in rounds if one.stage == "confirmation" for seed in one.seeds]
    searching = [seed for one in rounds if one.stage != "confirmation" for seed in one.seeds]
    assert max(searching) < FIRST_CONFIRMATION_SEED <= min(confirming)
    assert max(confirming) < FIRST_TRAINING_SEED


@pytest.mark.parametrize("states", [LEAST_STATES, 50])
@pytest.mark.parametrize(("count", "budget"), [(1, 40), (2, 100), (2, MOST_EPISODES), (18, 420), (18, 5000)])
def test_of_limited_start_states_none_is_played_twice_and_none_of_the_search_confirms(count, budget, states):
    rounds = []
    policy = Policy(**{f"axis{n}": 2.0 + n for n in range(count)})
    found = run(policy, budget, rounds=rounds, start_states=states)
    played = [(point, seed) for one in rounds for point in one.points for seed in one.seeds]
    assert len(set(played)) == len(played) == found.episodes <= budget
    confirming = {seed for one in rounds if one.stage == "confirmation" for seed in one.seeds}
    searching = {seed for one in rounds if one.stage != "confirmation" for seed in one.seeds}
    assert not confirming & searching
    assert confirming | searching <= set(range(states))
    assert found.axes[0].boundary.value == pytest.approx(policy.alone("axis0"), abs=0.8)


def test_axes_that_do_not_combine_are_never_combined():
    rounds = []
    apart = {"a", "b"}
    policy = Policy(a=2.0, b=2.0, c=3.0)
    run(policy, 600, rounds=rounds, combine=lambda names: not apart <= set(names))
    points = [{axis for axis, _ in point} for one in rounds for point in one.points]
    assert not [names for names in points if apart <= names]
    assert [names for names in points if len(names) == 2]


def test_whole_axes_are_played_at_whole_severities_and_others_up_to_five():
    rounds = []
    run(Policy(a=2.0, b=3.0, c=9.0), 600, rounds=rounds, whole=("b",))
    severities = [(axis, severity) for one in rounds for point in one.points for axis, severity in point]
    assert all(float(severity).is_integer() for axis, severity in severities if axis == "b")
    assert all(0 < severity <= 5 and severity == round(severity, 2) for _, severity in severities)


def test_a_policy_that_cannot_do_the_task_is_not_searched():
    found = run(Policy(clean=0.05, a=2.0, b=3.0), 300)
    assert found.axes == ()
    assert found.combined is None
    assert found.episodes < 150


def test_a_budget_out_of_range_is_refused():
    for budget in (least_budget(2) - 1, MOST_EPISODES + 1):
        with pytest.raises(ValueError, match=f"got {budget}"):
            next(search_worst_cases(SearchSpace(("a", "b")), budget))


def test_the_estimate_narrows_and_episodes_without_verdict_change_nothing():
    estimate = BoundaryEstimate(5.0)
    before = estimate.boundary()
    estimate.tell(2.0, Trials())
    assert estimate.boundary() == before
    estimate.tell_clean(Trials(20, 20))
    estimate.tell(2.0, Trials(20, 20))
    estimate.tell(3.0, Trials(0, 20))
    found = estimate.boundary()
    assert 2.0 < found.low < found.value < found.high < 3.0
    assert found.value <= estimate.to_confirm(20) <= 3.2
    assert estimate.to_confirm(1) is None
    assert estimate.to_confirm(0) is None


def test_excess_with_the_whole_clean_rate_is_the_interval_of_a_difference():
    low, high = excess(Trials(56, 70), Trials(48, 80), 1.0)
    assert (low, high) == pytest.approx((0.0524, 0.3339), abs=1e-4)  # Newcombe 1998, table II, method 10
    assert excess(Trials(), Trials(5, 5), 0.5) == (-1.0, 1.0)
