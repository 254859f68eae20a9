"""Comparisons that stop when they are decided: rounds, remaining work and error rates."""

import numpy as np
import pytest
from typer.testing import CliRunner

from robogauntlet.orchestrator.cli import app
from robogauntlet.orchestrator.runs.adaptive_stopping import key_of, progression
from robogauntlet.orchestrator.runs.plan import make_plan
from robogauntlet.results.report import ReportPaths
from robogauntlet.results.run_document import RunStatus, read_run
from robogauntlet.suites.episode import Condition
from robogauntlet.suites.loading import SuiteError
from robogauntlet.suites.schema import AdaptiveEntry, CompareEntry, Seeds
from tests.orchestrator.runs.playing import play, rows_of
from tests.results.synthetic import cells

CONDITIONS = (Condition(), Condition("noise", 2), Condition("noise", 4), Condition("blind", 1))
TASKS = ("maniskill/PushCube-v1", "robosuite/Lift")
CELLS = cells(("expert", "merged"), TASKS, CONDITIONS)
SIDES = CompareEntry(baseline="expert", others=("merged",))
SEEDS = Seeds(start=100, count=20)
RULE = AdaptiveEntry(round=10, max_seeds=60)


def simulate(rates, seed=0, rule=RULE, seeds=SEEDS):
    """Play round after round; `rates` gives the success of a policy under a condition."""
    generator, outcomes, rounds = np.random.default_rng(seed), {}, []
    while (found := progression(CELLS, seeds, rule, SIDES, outcomes)).work:
        rounds.append({cell: list(lacking) for cell, lacking in found.work})
        for cell, lacking in found.work:
            rate = rates(cell.policy, cell.condition)
            for number in lacking:
                outcomes.setdefault(key_of(cell), {})[number] = "success" if generator.random() < rate else "failure"
    return found, rounds, outcomes


def differ_at_4(policy, condition):
    return 0.1 if (policy, condition) == ("merged", Condition("noise", 4)) else 0.9


def test_a_decided_condition_stops_and_the_others_get_its_episodes():
    found, rounds, _ = simulate(differ_at_4)
    (decided,) = found.decided
    assert (decided.policy, decided.axis, decided.severity) == ("merged", "noise", 4)
    assert decided.evidence >= 20
    asked = {cell.condition: seeds for cell, seeds in found.planned.items()}
    assert asked[Condition("noise", 4)] == decided.seeds < 20
    assert asked[Condition("noise", 2)] > 20
    assert asked[Condition()] == asked[Condition("noise", 2)]
    assert sum(found.planned.values()) <= len(CELLS) * SEEDS.count
    assert all(len(lacking) <= 10 for played in rounds for lacking in played.values())


def test_controls_get_only_the_seeds_of_the_suite():
    found, _, _ = simulate(lambda policy, condition: 0.9)
    assert {found.planned[cell] for cell in CELLS if cell.condition == Condition("blind", 1)} == {20}


def test_without_a_decision_the_same_episodes_are_played_as_without_stopping():
    found, _, outcomes = simulate(lambda policy, condition: 0.9)
    assert found.decided == []
    assert set(found.planned.values()) == {20}
    assert {tuple(sorted(played)) for played in outcomes.values()} == {tuple(range(100, 120))}


def test_no_condition_gets_more_than_the_maximum_of_seeds():
    rule = AdaptiveEntry(round=10, max_seeds=30)
    found, _, _ = simulate(differ_at_4, rule=rule, seeds=Seeds(start=0, count=29))
    assert max(found.planned.values()) <= 30


def test_rounds_do_not_depend_on_the_order_of_outcomes():
    found, _, outcomes = simulate(differ_at_4)
    shuffled = {
        key: dict(sorted(played.items(), reverse=True)) for key, played in sorted(outcomes.items(), reverse=True)
    }
    again = progression(CELLS, SEEDS, RULE, SIDES, shuffled)
    assert (again.work, again.planned, again.decided) == ([], found.planned, found.decided)


def test_the_work_of_a_round_is_its_seeds_without_a_row():
    _, rounds, _ = simulate(differ_at_4)
    first = CELLS[0]
    some = {key_of(first): dict.fromkeys(range(100, 104), "success")}
    found = progression(CELLS, SEEDS, RULE, SIDES, some)
    assert dict(found.work)[first] == list(range(104, 110))
    assert dict(found.work)[CELLS[1]] == rounds[0][CELLS[1]]


def test_errors_count_as_rows_but_not_as_evidence():
    outcomes = {key_of(cell): dict.fromkeys(range(100, 110), "error") for cell in CELLS}
    found = progression(CELLS, SEEDS, RULE, SIDES, outcomes)
    assert found.decided == []
    assert {s for _, lacking in found.work for s in lacking} == set(range(110, 120))


def test_true_null_hypotheses_are_rejected_with_a_probability_of_at_most_alpha():
    """150 runs of two perturbed conditions without a difference, evaluated after every round of 5 seeds."""
    rule = AdaptiveEntry(round=5, max_seeds=200)
    wrong = [len(simulate(lambda p, c: 0.6, seed, rule, Seeds(start=0, count=40))[0].decided) for seed in range(150)]
    false = sum(wrong) / (150 * 3)  # noise@2, noise@4 and the control
    assert false <= 0.05 + 2 * (0.05 * 0.95 / 450) ** 0.5


SUITE = """
name: adapting
policies: [oracle, random, zero]
tasks: [null/Reach]
conditions: [clean, {axis: noise, severities: [1, 2]}]
seeds: {count: 20}
compare: {baseline: oracle, others: [random]}
adaptive: {round: 5, max_seeds: 60}
"""


@pytest.mark.ray
@pytest.mark.usefixtures("ray_here")
def test_a_decided_adaptive_run_stops_and_reports_it_and_has_no_remaining_work(tmp_path, suite_file):
    folder, suite = tmp_path / "run", suite_file(SUITE)
    outcome = play(suite, folder)
    assert outcome.document.status is RunStatus.COMPLETE
    assert {(row.axis, row.severity) for row in outcome.document.decided} == {("noise", 1), ("noise", 2)}
    assert outcome.done == outcome.document.planned < 3 * 3 * 20
    played = {(row.axis, row.severity, row.seed) for row in rows_of(folder)}
    assert max(seed for axis, _, seed in played if axis != "clean") == outcome.document.decided[0].seeds - 1
    report = ReportPaths.in_folder(folder).markdown.read_text()
    assert "A condition stops when the e-value of oracle" in report
    spared = 180 - outcome.done
    assert f"Of the suite's 180 episodes, {spared} were not needed after their condition was decided" in report
    assert play(suite, folder).document.rows_hash == outcome.document.rows_hash
    assert read_run(folder).decided == outcome.document.decided
    planned = CliRunner().invoke(app, ["plan", str(suite), "--out", str(folder)])
    assert "180 episodes, 0 to play in the current round" in planned.output


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (SUITE.replace("compare: {baseline: oracle, others: [random]}\n", ""), "nothing to decide; add compare"),
        (SUITE.replace("max_seeds: 60", "max_seeds: 10"), "expected 20 seeds or more, got 10"),
        (SUITE.replace("round: 5", "round: 0"), "round"),
        (SUITE.replace("round: 5", "alpha: 1.5"), "alpha"),
        (SUITE.replace("others: [random]", "others: [radnom]"), "compare names no policy of this suite: 'radnom'; did"),
        (SUITE.replace("others: [random]", "others: [oracle]"), "compare names policy 'oracle' twice"),
        (
            SUITE + "no_skill_baselines: [zeroo]\n",
            "no_skill_baselines names no policy of this suite: 'zeroo'; did you mean 'zero'",
        ),
    ],
)
def test_an_impossible_rule_is_refused_with_its_line(suite_file, text, message):
    with pytest.raises(SuiteError, match=message):
        make_plan(suite_file(text))
