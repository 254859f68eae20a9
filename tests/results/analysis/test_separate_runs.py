"""Two runs whose trials are not paired: policies on separate trials, and how well one run predicts the other."""

import json
import math
import re
from dataclasses import replace
from statistics import NormalDist

import numpy as np
import pytest

from robogauntlet.results import api
from robogauntlet.results.analysis.comparison import Difference, Verdict
from robogauntlet.results.report.comparison import as_json, as_markdown
from robogauntlet.results.run_document import RunError, RunStatus
from robogauntlet.results.statistics.rank_agreement import kendall, pearson, rank_violation, rate_agreement_bounds
from robogauntlet.results.statistics.rates import Interval
from robogauntlet.results.store.foreign.csv_table import read_csv
from robogauntlet.results.store.foreign.run import import_results
from robogauntlet.suites.episode import Condition
from tests.errors import one_line_error
from tests.results.synthetic import cells, document, rows_where, run_folder

REACH = "pybullet/Reach"
SIMULATED = {"a": 180, "b": 100, "c": 20}
REAL = {"a": 80, "b": 140, "c": 20}


def trials(won, task=REACH, count=20, column="trial"):
    """Trials of a task, of which policies succeed in the first so many."""
    return [f"{policy},{task},{n},{int(n < own)}" for policy, own in won.items() for n in range(count)], column


def import_trials(root, name, *tables, errors=False):
    lines = [line for own, _ in tables for line in own]
    results = read_csv("\n".join([f"policy,task,{tables[0][1]},success", *lines]).encode())
    if errors:
        failed = tuple(replace(trial, success=None, error="timeout") for trial in results.trials)
        results = replace(results, trials=failed)
    return import_results(results, [], root, suite=name, name=name)[0]


@pytest.fixture
def make(tmp_path):
    """Make a run of tables of trials."""
    return lambda name, *tables, **options: import_trials(tmp_path, name, *tables, **options)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A simulated run and a real one, 200 trials of each policy."""
    root = tmp_path_factory.mktemp("runs")
    return [import_trials(root, name, trials(won, count=200)) for name, won in (("sim", SIMULATED), ("real", REAL))]


def difference(first, second, z):
    """Newcombe's interval of the difference of two rates, by its formula."""
    ends = []
    for won, n in (first, second):
        p = won / n
        centre, half = p + z * z / (2 * n), z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
        ends.append((p, (centre - half) / (1 + z * z / n), (centre + half) / (1 + z * z / n)))
    (p, low, high), (q, least, most) = ends
    return p - q - math.hypot(p - low, most - q), p - q + math.hypot(high - p, q - least)


def test_policies_are_compared_on_separate_trials_and_the_prediction_is_measured(runs):
    found = api.compare(*runs)
    assert (found.verdict, found.comparisons) == (Verdict.SEPARATE, ())
    assert [one.overall.difference.value for one in found.separate] == pytest.approx([0.5, -0.2, 0.0])
    agreement = found.agreement
    assert [(one.policy, one.first.value, one.second.value) for one in agreement.policies] == [
        *(("a", 0.9, 0.4), ("b", 0.5, 0.7), ("c", 0.1, 0.1))
    ]
    # Deviations from the means: 0.4, 0, -0.4 and 0, 0.3, -0.3.
    assert agreement.pearson == pytest.approx(0.12 / math.sqrt(0.32 * 0.18))
    # Two pairs have the same order, a and b another one, which costs both of them 0.3.
    assert agreement.tau.value == pytest.approx(1 / 3)
    assert agreement.violation.value == pytest.approx((0.3 + 0.3 + 0) / 3)
    # Six differences of rates; all of them are shown.
    low, high = difference((140, 200), (80, 200), NormalDist().inv_cdf(1 - 0.05 / 6 / 2))
    assert agreement.tau.interval == Interval(pytest.approx(1 / 3), pytest.approx(1 / 3))
    assert agreement.violation.interval == Interval(pytest.approx(2 * low / 3), pytest.approx(2 * high / 3))


def test_what_is_not_shown_widens_the_intervals(make):
    sim, real = ({name: won // 10 for name, won in own.items()} for own in (SIMULATED, REAL))
    found = api.compare(make("sim", trials(sim)), make("real", trials(real))).agreement
    assert (found.tau.value, found.violation.value) == (pytest.approx(1 / 3), pytest.approx(0.2))
    z = NormalDist().inv_cdf(1 - 0.05 / 6 / 2)
    shown = [[difference((own[a], 20), (own[b], 20), z) for a, b in ("ab", "ac", "bc")] for own in (sim, real)]
    # All orders are shown in the first run, in the second one that b is better than c only.
    assert [[low > 0 or high < 0 for low, high in own] for own in shown] == [[True] * 3, [False, False, True]]
    assert found.tau.interval == Interval(pytest.approx(-1 / 3), 1.0)
    ab, ac = (max(-low, high) for low, high in shown[1][:2])
    assert found.violation.interval == Interval(0.0, pytest.approx((max(ab, ac) + ab + ac) / 3))


def test_a_rate_is_the_mean_over_the_tasks_that_every_policy_has_in_both_runs(make):
    won = {"a": 9, "b": 5, "c": 1}
    sim = make("sim", trials(won, "x/one", 10), trials(won, "x/two", 40), trials(won, "x/only", 10))
    real = make("real", trials(won, "x/one", 10), trials(won, "x/two", 10), trials({"a": 1}, "x/only", 10))
    found = api.compare(sim, real).agreement
    assert found.tasks == ("x/one", "x/two")
    assert found.policies[0].first.value == pytest.approx((9 / 10 + 9 / 40) / 2)
    # Its interval is that of 16 trials of each task, the harmonic mean of 10 and 40.
    p, n, z = 0.5625, 32, NormalDist().inv_cdf(0.975)
    centre, half = p + z * z / (2 * n), z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    ends = [pytest.approx((centre + sign * half) / (1 + z * z / n)) for sign in (-1, 1)]
    assert found.policies[0].first.interval == Interval(*ends)


def test_the_words_have_these_numbers(runs):
    found = api.compare(*runs, margin=0.1)
    lines = str(found).splitlines()
    ends = ", ".join(f"{100 * end:.1f}" for end in difference((180, 200), (80, 200), NormalDist().inv_cdf(0.975)))
    assert lines[:3] == [
        "separate trials, not paired: sim against real",
        f"- a: +50.0 [{ends}] points, adjusted p <0.001, not paired: 200 and 200 trials",
        "- a: Success in separate trials: sim 90 % (180 of 200), real 40 % (80 of 200). The difference is significant "
        "at 5 %.",
    ]
    assert "- c: It is shown that sim is no worse than real by more than 10 points." in lines
    assert (
        "- sim predicts real, by 3 policies in 1 task: Pearson's r 0.50, Kendall's tau 0.33 [0.33, 0.33], "
        "MMRV 0.20 [0.11, 0.28] (a success rate in real; 0 is best)"
    ) in lines
    assert "at least 95 %, for these 3 policies only" in lines[-1]
    assert "r has no interval" in lines[-1]
    page = as_markdown(found)
    assert "| a | 90 % [85, 93] | 40 % [33, 47] |" in page
    assert "which are not paired: Fisher's exact test" in page
    assert "McNemar" not in page
    read = json.loads(as_json(found))
    assert read["verdict"] == "separate trials"
    assert read["agreement"]["tau"]["value"] == pytest.approx(1 / 3)
    assert read["reasons"] == [line[2:] for line in lines[1:]]
    assert [one["overall"]["counts"]["first"] for one in read["separate"]] == [180, 100, 20]


def test_a_run_that_was_played_is_compared_by_its_clean_episodes(make, tmp_path):
    plan = cells(("a", "b", "c"), (REACH,), (Condition(), Condition("noise", 2)))
    won = {"a": 18, "b": 10, "c": 2}
    rows = rows_where(lambda cell, seed: cell.condition == Condition() and seed < won[cell.policy], plan, 20)
    sim = run_folder(tmp_path / "sim", document(20, plan, status=RunStatus.INTERRUPTED), rows)
    found = api.compare(
        sim, make("real", trials({"a": 8, "b": 14, "c": 2}, "reach", 20)), tasks={REACH: "trials/reach"}
    )
    assert [one.first.value for one in found.agreement.policies] == [0.9, 0.5, 0.1]
    assert [one.task for one in found.separate[0].tasks] == [REACH]
    assert found.differences == {Difference.UNFINISHED: "sim is interrupted"}


def test_trials_of_others_with_states_are_separate_from_those_that_were_played_and_paired_with_their_own(make):
    seeded = [make(name, trials({"a": won}, column="seed")) for name, won in (("one", 5), ("two", 15))]
    assert api.compare(*seeded, allowed={Difference.SUITE}).verdict is Verdict.REGRESSED
    apart = make("apart", trials({"a": 10}))
    assert api.compare(seeded[0], apart).verdict is Verdict.SEPARATE
    with one_line_error(RunError, "one: expected no other names of tasks, its episodes are paired by their own"):
        api.compare(*seeded, tasks={REACH: REACH})


def test_runs_of_one_name_are_told_apart_by_their_paths(tmp_path):
    folders = [import_trials(tmp_path / place, "night", trials({"a": won})) for place, won in (("x", 5), ("y", 6))]
    assert str(api.compare(*folders)).startswith(f"separate trials, not paired: {folders[0]} against {folders[1]}\n")


def test_equal_rates_have_no_correlation(make):
    found = api.compare(make("sim", trials(dict.fromkeys("abc", 5))), make("real", trials({"a": 1, "b": 2, "c": 3})))
    assert (found.agreement.pearson, found.agreement.tau) == (None, None)
    assert "Pearson's r –, Kendall's tau –, MMRV" in str(found)
    assert "r and tau are not defined where all policies have the same rate in a run" in str(found)


@pytest.mark.parametrize(
    ("won", "task", "options", "verdict", "message"),
    [
        ({"a": 1, "b": 1}, REACH, {}, Verdict.SEPARATE, "is not said: expected 3 to 100 policies .* runs have, got 2"),
        ({"a": 1, "b": 1, "C": 1}, REACH, {}, Verdict.SEPARATE, "that only real has: C; did you mean 'c'"),
        ({"d": 1}, REACH, {}, Verdict.NOT_COMPARABLE, "policies that only sim has: a, b, c"),
        (
            {"a": 1, "b": 2, "c": 3},
            "x/pick",
            {},
            Verdict.NOT_COMPARABLE,
            "a, b, c: expected a task that both runs have, got .* x/pick",
        ),
        (
            {"a": 1, "b": 2, "c": 3},
            "reach",
            {},
            Verdict.NOT_COMPARABLE,
            "did you mean 'pybullet/Reach'.*--task TASK=OTHER says which",
        ),
        (
            {"a": 1, "b": 2, "c": 3},
            REACH,
            {"errors": True},
            Verdict.NOT_COMPARABLE,
            "verdict in real, got none, 20 errors",
        ),
    ],
)
def test_what_cannot_be_compared_is_named(make, won, task, options, verdict, message):
    found = api.compare(make("sim", trials(dict.fromkeys("abc", 5))), make("real", trials(won, task), **options))
    assert (found.verdict, found.agreement) == (verdict, None)
    assert any(re.search(message, note) for note in found.notes), found.notes


@pytest.mark.parametrize(
    ("tasks", "message"),
    [
        ({"x/reach": REACH}, "sim: the run has no task 'x/reach'; did you mean 'pybullet/Reach'"),
        ({REACH: "x/Reach"}, "real: the run has no task 'x/Reach'"),
        ({REACH: "pybullet/Push"}, "real: expected another task for each task of sim, got one for two"),
        ({REACH: REACH, "pybullet/Push": REACH}, "real: expected another task for each task of sim, got one for two"),
    ],
)
def test_names_of_tasks_that_say_nothing_are_refused(make, tasks, message):
    runs = [make(name, trials({"a": 1}), trials({"a": 1}, "pybullet/Push")) for name in ("sim", "real")]
    with one_line_error(RunError, message):
        api.compare(*runs, tasks=tasks)


def test_a_task_that_all_policies_have_is_needed(make):
    sides = [make(name, *(trials({one: 5}, f"x/{one}", 10) for one in "abc")) for name in ("sim", "real")]
    found = api.compare(*sides)
    assert found.notes == (
        "how well sim predicts real is not said: expected a task that all 3 policies have in both runs, got none",
    )


@pytest.mark.parametrize("policies", [3, 5, 8])
@pytest.mark.parametrize("order", ["equal", "perfect", "reversed"])
def test_the_intervals_of_tau_and_violation_cover_the_true_values(policies, order):
    generator, count, shares = np.random.default_rng(0), 40, np.linspace(0.2, 0.9, policies)
    real = {"equal": np.linspace(0.5, 0.51, policies), "perfect": shares, "reversed": shares[::-1]}[order]
    expected = kendall(shares, real)[0], rank_violation(real, shares)
    covered = 0
    for _ in range(count):
        sides = [[(float(won), 50.0) for won in generator.binomial(50, rates)] for rates in (real, shares)]
        bounds = rate_agreement_bounds(*sides, 0.95)
        covered += all(one.low - 1e-9 <= value <= one.high + 1e-9 for one, value in zip(bounds, expected, strict=True))
    assert covered >= 0.95 * count


def test_an_interval_of_r_by_resampled_trials_would_miss_the_true_one():
    """Why r is printed without an interval: of two runs that agree, r is 1, and no resample reaches that."""
    generator, shares, covered = np.random.default_rng(0), np.linspace(0.2, 0.9, 5), 0
    for _ in range(40):
        sides = generator.binomial(50, shares, (2, 5)) / 50
        drawn = generator.binomial(50, sides, (100, 2, 5))
        found = [r for one, other in drawn if (r := pearson(one, other)) is not None]
        covered += bool(np.quantile(found, 0.025) <= 1 <= np.quantile(found, 0.975))
    assert covered < 0.5 * 40
