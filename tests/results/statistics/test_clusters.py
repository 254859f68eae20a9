"""Failure clusters."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from robogauntlet.results.statistics import clusters as module
from robogauntlet.results.statistics.clusters import AxisCondition, failure_clusters

few = settings(max_examples=10, deadline=None)
AXES = ("blur", "light", "table", "noise")
PAIR = (AxisCondition("blur", 3), AxisCondition("light", 3))


def generator(seed=0):
    return np.random.default_rng(seed)


def episodes(rate, seed=0, points=200, seeds=4, axes=4):
    """Severities, failures and seeds of points that are played at the same seeds each."""
    draw = generator(seed)
    severities = np.repeat(draw.uniform(0, 5, (points, axes)), seeds, axis=0)
    return severities, draw.random(points * seeds) < rate(severities), np.tile(np.arange(seeds), points)


def planted(severities):
    return np.where((severities[:, :2] >= 3).all(axis=1), 0.9, 0.1)


def clusters(data, seed=1, axes=AXES, **options):
    return failure_clusters(*data, axes, generator(seed), **options)


def conditions(found):
    return [cluster.conditions for cluster in found]


def test_a_planted_pair_is_the_first_cluster():
    assert conditions(clusters(episodes(planted)))[0] == PAIR


def test_a_pair_is_not_reported_again_as_its_conditions_alone():
    found = clusters(episodes(planted, points=400))
    assert conditions(found) == [PAIR]


def test_a_single_condition_is_found():
    found = clusters(episodes(lambda severities: np.where(severities[:, 2] >= 4, 0.8, 0.2)))
    assert conditions(found) == [(AxisCondition("table", 4),)]


def test_a_condition_that_matters_beyond_its_pair_is_reported_too():
    def rate(severities):
        return np.where((severities[:, :2] >= 3).all(axis=1), 0.95, np.where(severities[:, 0] >= 3, 0.5, 0.05))

    found = conditions(clusters(episodes(rate, points=800)))
    assert set(found) == {PAIR, PAIR[:1]}


def test_rates_have_the_episodes_that_confirm_and_a_lift_is_their_ratio():
    data = episodes(planted)
    found = clusters(data)[0]
    assert found.within.value == found.confirmation.failures / found.confirmation.episodes
    assert found.within.interval.low <= found.within.value <= found.within.interval.high
    assert found.outside.interval.low <= found.outside.value <= found.outside.interval.high
    assert found.lift == found.within.value / found.outside.value
    assert found.p_value <= 0.05


def test_no_point_and_no_seed_is_in_both_halves():
    """With 200 points at 4 seeds, at most 100 points at 2 seeds are left for each half."""
    severities, failed, seeds = episodes(planted)
    within = int((severities[:, :2] >= 3).all(axis=1).sum())
    found = clusters((severities, failed, seeds))[0]
    assert found.discovery.episodes + found.confirmation.episodes == within // 2


def test_other_points_at_every_seed_use_all_episodes():
    severities, failed, _ = episodes(planted, points=800, seeds=1)
    found = clusters((severities, failed, np.arange(800) % 4))[0]
    assert found.discovery.episodes + found.confirmation.episodes == (severities[:, :2] >= 3).all(axis=1).sum()


def test_a_lift_is_infinite_where_nothing_fails_outside():
    found = clusters(episodes(lambda severities: (severities[:, 0] >= 4) * 1.0))
    assert conditions(found) == [(AxisCondition("blur", 4),)]
    assert found[0].lift == math.inf


@pytest.mark.parametrize("kind", ["points at all seeds", "points at one seed"])
def test_failures_that_are_alike_everywhere_hardly_ever_give_a_cluster(kind):
    crossed = kind == "points at all seeds"
    reported = 0
    for seed in range(40):
        data = episodes(lambda s: np.full(len(s), 0.3), seed, 200 if crossed else 800, 4 if crossed else 1)
        data = data if crossed else (*data[:2], np.arange(800) % 4)
        reported += bool(clusters(data, seed))
    assert reported <= 4


def test_failures_that_grow_along_one_axis_hardly_ever_give_a_pair():
    found = [clusters(episodes(lambda s: 0.1 + 0.16 * s[:, 0], seed), seed) for seed in range(40)]
    assert sum(any(len(cluster.conditions) > 1 for cluster in own) for own in found) <= 4
    assert sum(PAIR[0].axis in [c.conditions[0].axis for c in own] for own in found) >= 36


def test_an_axis_that_follows_another_gives_hardly_ever_a_pair():
    """Failures grow with the first axis alone, and the second is rarely more than one severity from it."""
    reported = 0
    for seed in range(40):
        severities, _, seeds = episodes(planted, seed, points=400)
        draw = generator(seed)
        first = np.repeat(draw.integers(0, 6, 400), 4)
        severities[:, 0] = first
        severities[:, 1] = np.clip(first + np.repeat(draw.integers(-1, 2, 400), 4), 0, 5)
        found = clusters((severities, draw.random(1600) < 0.05 + 0.18 * first, seeds), seed)
        reported += any(len(cluster.conditions) > 1 for cluster in found)
    assert reported <= 4


def test_points_that_always_fail_are_no_evidence_beyond_their_number():
    """Failures that depend on the point alone, at random: each point counts once, not once per seed."""
    reported = 0
    for seed in range(40):
        severities, _, seeds = episodes(planted, seed, points=50, seeds=16)
        failed = np.repeat(generator(seed).random(50) < 0.4, 16)
        reported += bool(clusters((severities, failed, seeds), seed))
    assert reported <= 4


@given(st.integers(0, 1000))
@few
def test_the_order_of_episodes_changes_nothing(seed):
    severities, failed, seeds = episodes(planted)
    order = generator(seed).permutation(len(seeds))
    assert clusters((severities[order], failed[order], seeds[order])) == clusters((severities, failed, seeds))


@given(st.lists(st.integers(-(10**9), 10**9), min_size=4, max_size=4, unique=True))
@few
def test_other_names_of_seeds_in_the_same_order_change_nothing(labels):
    severities, failed, seeds = episodes(planted)
    assert clusters((severities, failed, np.array(sorted(labels))[seeds])) == clusters((severities, failed, seeds))


def test_other_names_of_axes_change_only_the_names():
    data = episodes(planted)
    renamed = clusters(data, axes=("a", "b", "c", "d"))
    assert conditions(renamed)[0] == (AxisCondition("a", 3), AxisCondition("b", 3))
    assert [cluster.p_value for cluster in renamed] == [cluster.p_value for cluster in clusters(data)]


def test_the_same_generator_gives_the_same_clusters():
    assert clusters(episodes(planted), 7) == clusters(episodes(planted), 7)


def test_clusters_are_ranked_by_lift():
    def rate(severities):
        return np.where(severities[:, 3] >= 4, 0.6, np.where((severities[:, :2] >= 3).all(axis=1), 0.9, 0.05))

    lifts = [cluster.lift for cluster in clusters(episodes(rate, points=800))]
    assert len(lifts) > 1
    assert lifts == sorted(lifts, reverse=True)


def test_without_failures_or_without_successes_there_is_no_cluster():
    severities, failed, seeds = episodes(planted)
    assert clusters((severities, np.zeros_like(failed), seeds)) == ()
    assert clusters((severities, np.ones_like(failed), seeds)) == ()


def test_a_single_seed_gives_no_cluster():
    severities, failed, _ = episodes(planted)
    assert clusters((severities, failed, np.zeros(len(failed), dtype=int))) == ()


def test_few_episodes_give_no_cluster():
    assert clusters(episodes(planted, points=5)) == ()


def test_a_smaller_alpha_reports_no_more():
    data = episodes(planted, points=64)
    assert set(conditions(clusters(data, alpha=0.001))) <= set(conditions(clusters(data)))


GOOD = episodes(planted, points=5)


@pytest.mark.parametrize(
    ("place", "wrong", "message"),
    [
        (0, GOOD[0][:, :3], r"expected severities of shape \(episodes, 4\), got \(20, 3\)"),
        (0, GOOD[0][0], "expected severities of shape"),
        (0, GOOD[0] + 5, "expected severities from 0 to 5 and none missing"),
        (0, GOOD[0] * np.nan, "expected severities from 0 to 5 and none missing"),
        (1, GOOD[1][1:], "expected 20 outcomes and seeds"),
        (1, GOOD[1] * 1.0, "expected outcomes that are true or false, got float64"),
        (2, GOOD[2][1:], "expected 20 outcomes and seeds"),
        (2, GOOD[2] * 1.0, "expected seeds that are integers, got float64"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(place, wrong, message):
    data = list(GOOD)
    data[place] = wrong
    with pytest.raises(ValueError, match=message):
        clusters(data)


def test_no_episodes_are_refused():
    with pytest.raises(ValueError, match="expected at least one episode, got none"):
        clusters([array[:0] for array in GOOD])


def test_names_that_repeat_are_refused():
    with pytest.raises(ValueError, match="expected names of axes that differ"):
        clusters(GOOD, axes=("blur", "blur", "table", "noise"))


@pytest.mark.parametrize("alpha", [0, 1, -0.5, math.nan])
def test_an_impossible_alpha_is_refused(alpha):
    with pytest.raises(ValueError, match="expected an alpha between 0 and 1"):
        clusters(GOOD, alpha=alpha)


def test_axes_that_are_too_rare_for_a_cluster_are_in_no_pair(monkeypatch):
    scored, really = [], module._scores
    monkeypatch.setattr(module, "_scores", lambda half, chosen: scored.append(chosen) or really(half, chosen))
    severities, failed = np.repeat(np.eye(90), 2, axis=0), np.tile([True, False], 90)
    axes = [f"axis-{number}" for number in range(90)]
    failure_clusters(severities, failed, np.tile([0, 1], 90), axes, generator())
    assert scored == []


def test_pairs_of_very_many_axes_are_left_out(monkeypatch):
    scored, really = [], module._scores
    monkeypatch.setattr(module, "_scores", lambda half, chosen: scored.append(chosen) or really(half, chosen))
    number = module.MOST_AXES + 1
    clusters(episodes(lambda levels: levels[:, 0] / 5, axes=number), axes=[f"axis-{n}" for n in range(number)])
    assert scored == [(n,) for n in range(number)]
