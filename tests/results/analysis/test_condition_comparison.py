"""What a policy loses against another under perturbations."""

import dataclasses

import numpy as np
import pytest

from robogauntlet.results.analysis.condition_comparison import equivalence, interaction
from robogauntlet.results.analysis.robustness import Repeats
from robogauntlet.results.report import condition_comparison as words
from robogauntlet.results.report.findings import findings
from robogauntlet.suites.episode import Condition
from robogauntlet.suites.schema import AdaptiveEntry, CompareEntry
from tests.results.synthetic import cells, document, robustness_of, row, rows_where

AXES = ("noise", "blur")
CONDITIONS = (Condition(), *(Condition(axis, severity) for axis in AXES for severity in (2, 4)))
TASKS = ("maniskill/PushCube-v1", "pybullet/PandaPush-v3")
PLAN = cells(("expert", "merged"), TASKS, CONDITIONS)
SEEDS = 50
RATE = {("expert", "noise"): 0.9, ("expert", "blur"): 0.9, ("merged", "noise"): 0.3, ("merged", "blur"): 0.8}
"""Under perturbation; clean the expert has 0.9 and merged 0.8."""
COMPARE = CompareEntry(baseline="expert", others=("merged",))


def rows(seed=0, wrong=0.0, plan=PLAN):
    """Rows with these rates; of merged, this share under noise is misrouted, and fails."""
    generator, found = np.random.default_rng(seed), []
    for cell in plan:
        clean = 0.9 if cell.policy == "expert" else 0.8
        rate = RATE.get((cell.policy, cell.condition.axis), clean) if cell.condition.severity else clean
        for number in range(SEEDS):
            won, inferred = generator.random() < rate, cell.task if cell.policy == "merged" else None
            if inferred and cell.condition.axis == "noise" and generator.random() < wrong:
                won, inferred = False, TASKS[cell.task == TASKS[0]]
            found.append(row(cell, number, "success" if won else "failure", inferred_task=inferred))
    return found


def built(results=None, plan=PLAN, **changes):
    run = document(SEEDS, of=plan, **{"compare": COMPARE, **changes})
    return robustness_of(run, rows() if results is None else results)


def test_without_a_comparison_in_the_suite_none_is_made():
    assert built(compare=None).condition_comparison is None


def test_the_loss_at_every_level_is_paired_and_tested():
    comparison = built().condition_comparison
    assert [(t.axis, t.severity) for t in comparison.losses] == [
        *(("noise", 0), ("noise", 2), ("noise", 4)),
        *(("blur", 2), ("blur", 4)),
    ]
    noise = next(t for t in comparison.losses if (t.axis, t.severity) == ("noise", 4))
    assert noise.pairs == 2 * SEEDS
    assert noise.loss.value == pytest.approx(noise.baseline - noise.rate)
    assert noise.loss.interval.low > 0.3
    assert noise.p <= noise.adjusted < 0.001


def test_losing_more_than_under_the_clean_condition_is_shown_where_it_is_so():
    found = {row.axis: row for row in built().condition_comparison.interactions}
    assert found["noise"].is_shown
    assert found["noise"].extra.value == pytest.approx(0.5, abs=0.15)
    assert not found["blur"].is_shown
    corrected, own = found["noise"].corrected, found["noise"].extra.interval
    assert corrected.low < own.low < own.high < corrected.high


def compared(results, margin=0.05, **changes):
    return built(results, compare=COMPARE.model_copy(update={"margin": margin}), **changes)


def test_a_policy_that_loses_little_is_shown_to_be_equivalent_within_the_margin_that_the_suite_sets():
    """Both fail at every tenth seed, and merged at another one of fifty."""
    fails = {"expert": {0, 10, 20, 30, 40}, "merged": {0, 7, 10, 20, 30, 40}}
    same = [
        row(cell, seed, "failure" if seed in fails[cell.policy] else "success")
        for cell in PLAN
        for seed in range(SEEDS)
    ]
    robustness = compared(same, 0.06)
    (wide,) = robustness.condition_comparison.equivalences
    assert (wide.policy, wide.levels, wide.pairs) == ("merged", 4, 2 * 4 * SEEDS)
    assert wide.loss.value == pytest.approx(1 / SEEDS)
    assert wide.is_shown
    assert any(text.endswith("that they differ by less than 6 points is shown.") for text in findings(robustness))
    assert not compared(same, 0.01).condition_comparison.equivalences[0].is_shown


def test_a_policy_that_loses_more_than_the_margin_is_not_called_equivalent():
    robustness = compared(rows())
    (found,) = robustness.condition_comparison.equivalences
    assert found.loss.value == pytest.approx((0.6 + 0.1) / 2, abs=0.1)
    assert not found.is_shown
    (sentence,) = (text for text in findings(robustness) if "perturbed levels" in text)
    assert sentence.startswith("merged: +3")
    assert sentence.endswith("that they differ by less than 5 points is not shown.")


def test_equal_outcomes_have_no_interval_and_show_nothing():
    robustness = compared([row(cell, seed, "success") for cell in PLAN for seed in range(SEEDS)])
    assert not robustness.condition_comparison.equivalences[0].is_shown
    assert any("(no interval: the seeds of each task are alike)" in text for text in findings(robustness))


def test_a_level_without_a_verdict_of_both_does_not_count():
    (found,) = compared(
        rows(plan=[cell for cell in PLAN if (cell.policy, cell.condition.axis) != ("merged", "noise")])
    ).condition_comparison.equivalences
    assert (found.levels, found.pairs) == (2, 2 * 2 * SEEDS)
    assert found.loss.value == pytest.approx(0.1, abs=0.08)


def test_equivalence_is_tested_only_with_a_margin_and_a_number_of_seeds_that_was_fixed_before():
    assert not built().condition_comparison.equivalences
    adaptive = AdaptiveEntry(max_seeds=SEEDS)
    assert not compared(rows(), adaptive=adaptive).condition_comparison.equivalences


@pytest.mark.parametrize("spread", [(0, 1, 2, 3, 4, 5), (0,)])
def test_policies_that_differ_by_the_margin_are_rarely_called_equivalent(spread):
    """2,000 experiments of six tasks with four seeds and six levels; the seeds of these tasks differ, others agree."""
    generator, wrong = np.random.default_rng(12), 0
    for _ in range(2000):
        fails = [generator.random((4, 1)) < (0.3 if task in spread else 0.0) for task in range(6)]
        strata = [np.hstack([np.ones((4, 6)), 1.0 - np.tile(fail, 6)]) for fail in fails]
        found = equivalence("merged", strata, 0.3 * len(spread) / 6)
        wrong += found.is_shown
    assert wrong / 2000 <= 0.07


@pytest.mark.parametrize("families", [20, pytest.param(400, marks=pytest.mark.nightly)])
def test_a_loss_beyond_clean_that_is_none_is_shown_in_one_family_of_axes_of_twenty_at_most(families):
    """Of 18 axes, nine tasks and ten seeds: both policies lose as much under each axis as clean."""
    generator, false = np.random.default_rng(11), 0
    for _ in range(families):
        outcomes = (generator.random((18, 9, 10, 4)) < [0.9, 0.8, 0.9, 0.8]).astype(float)
        false += any(interaction("merged", "noise", list(axis), 18).is_shown for axis in outcomes)
    assert false / families <= 0.06


def test_errors_leave_their_pairs_out():
    clean = [cell for cell in PLAN if cell.policy == "expert" and cell.condition == Condition()]
    errors = {error.episode_id: error for error in (row(cell, 0, "error") for cell in clean)}
    results = [errors.get(result.episode_id, result) for result in rows()]
    assert next(t for t in built(results).condition_comparison.losses if not t.severity).pairs == 2 * SEEDS - 2


def test_the_accuracy_of_a_router_stands_beside_success():
    clean, _, last = [r for r in built(rows(1, wrong=0.9)).condition_comparison.routers if r.axis == "noise"]
    assert (clean.right.rate, clean.misrouted.trials) == (1.0, 0)
    assert last.right.rate < 0.2
    assert last.misrouted.rate == 0.0


def test_repeated_episodes_are_compared_to_the_bit():
    plan = cells(("expert",), TASKS, (Condition(), Condition("again", 1)))
    results = rows_where(lambda cell, seed: True, plan, 5)
    assert built(results, plan, compare=None).repeats == (Repeats("maniskill", 5, 5), Repeats("pybullet", 5, 5))
    results[-1] = dataclasses.replace(results[-1], final_state_hash="other")
    found = built(results, plan, compare=None)
    assert found.repeats == (Repeats("maniskill", 5, 5), Repeats("pybullet", 5, 4))
    assert words.repeats_sentence(found).endswith("5 of 5 in maniskill, 4 of 5 in pybullet.")
    assert found.controls == ()


def test_without_repeated_episodes_the_report_says_that_chance_was_not_tested():
    assert "was not tested" in words.repeats_sentence(built())


def test_findings_say_what_was_shown_and_no_more():
    found = findings(built())
    assert any(s.startswith("merged: success drops with severity along noise (") for s in found)
    assert any(s.startswith("merged: no significant drop along blur (not evidence of no drop)") for s in found)
    assert any("no significant drop along noise and blur (not" in s for s in found if s.startswith("expert"))
    assert any(s.startswith("merged loses more against expert than clean along noise (+") for s in found)


def test_findings_name_the_three_lowest_of_many_axes():
    axes = ("noise", "blur", "camera-orbit", "illuminance", "table")
    conditions = (Condition(), *(Condition(axis, 4) for axis in axes))
    plan = cells(("expert",), TASKS, conditions)
    left = dict(zip(axes, (30, 5, 25, 10, 15), strict=True))
    results = rows_where(lambda cell, seed: seed < left.get(cell.condition.axis, SEEDS), plan, SEEDS)
    (fall,) = [s for s in findings(built(results, plan, compare=None)) if "drops" in s]
    assert "success drops with severity along 5 of 5 axes, to the lowest rates along blur (100 % to 10 %" in fall
    assert "illuminance (" in fall
    assert "table (" in fall
    assert "noise" not in fall


def test_findings_do_not_claim_a_difference_that_chance_explains():
    plan = cells(("expert", "merged"), TASKS, CONDITIONS)
    found = findings(built(rows_where(lambda cell, seed: seed % 2, plan, SEEDS)))
    assert not any("falls" in s or "loses" in s for s in found)
    assert any(s.startswith("merged: no axis was shown to change its loss against expert") for s in found)


def test_false_findings_of_falls_are_rare_where_nothing_falls():
    """Equal rates at all levels: a fall along any of two axes of two policies is found in 1 of 10 runs at most."""
    generator, false = np.random.default_rng(7), 0
    for _ in range(20):
        level = rows_where(lambda cell, seed: generator.random() < 0.6, PLAN, 20)
        false += any("success drops" in s for s in findings(built(level)))
    assert false <= 5


def test_the_heat_map_has_the_clean_condition_once_and_a_column_per_simulator():
    expert, merged = words.heat_maps(built())
    assert (expert.policy, merged.policy) == ("expert", "merged")
    assert expert.columns == ("maniskill", "pybullet", "all")
    names = [name.partition(":")[0] for name, _ in merged.rows]
    assert names == ["clean", "noise@2", "noise@4", "blur@2", "blur@4"]
    name, cells = merged.rows[2]
    assert name == "noise@4: 18.4 dB PSNR"
    assert cells[0][1] == SEEDS


def test_heat_maps_of_no_skill_baselines_are_in_a_group_of_their_own():
    found = built(no_skill_baselines=("merged",))
    ((skilled,), (baseline,)) = (words.heat_map_groups(found, no_skill_baselines=one)[0] for one in (False, True))
    assert (skilled.policy, baseline.policy) == ("expert", "merged")
    ((expert, merged),) = words.heat_map_groups(built(), no_skill_baselines=False)
    assert (expert.policy, merged.policy) == ("expert", "merged")
    assert words.heat_map_groups(built(), no_skill_baselines=True) == ()


def test_the_rate_of_a_no_skill_baseline_is_subtracted_before_shares_are_computed():
    """Rates .9, .5 and .1 of the baseline: (.5 - .1) / (.9 - .1) is kept at level 4, not .5 / .9."""
    plan = cells(("expert", "replay"), TASKS, (Condition(), Condition("noise", 4)))
    left = {("expert", 0): 45, ("expert", 4): 25, ("replay", 0): 5, ("replay", 4): 5}
    results = rows_where(lambda cell, seed: seed < left[cell.policy, cell.condition.severity], plan, SEEDS)
    without, with_baseline = (
        built(results, plan, compare=None, no_skill_baselines=names) for names in ((), ("replay",))
    )
    whole, above = ({c.policy: c.curve for c in found.curves if not c.simulator} for found in (without, with_baseline))
    assert whole["expert"].retention[1] == pytest.approx(25 / 45)
    assert above["expert"].retention[1] == pytest.approx((0.5 - 0.1) / (0.9 - 0.1))
    assert above["replay"] == whole["replay"]
    assert words.no_skill_sentence(without) is None
    assert "Success of replay at the same level" in words.no_skill_sentence(with_baseline)


def capped_everywhere():
    """The oracle fails at noise@4 in every task, so that this level is left out."""
    plan = cells(("oracle", "expert", "merged"), TASKS, CONDITIONS)
    wins = {("expert", "clean"): 48, ("expert", "noise@2"): 45, ("merged", "noise@2"): 10, ("oracle", "noise@4"): 0}

    def is_success(cell, seed):
        return seed < wins.get((cell.policy, str(cell.condition)), SEEDS if cell.policy == "oracle" else 40)

    return built(rows_where(is_success, plan, SEEDS), plan, oracle_gate="oracle")


@pytest.mark.filterwarnings("error")
def test_a_level_that_is_left_out_in_every_task_is_in_no_loss_and_in_no_finding():
    found = capped_everywhere()
    noise = {row.axis: row for row in found.condition_comparison.interactions}["noise"]
    assert noise.extra.value == pytest.approx((45 - 10 - (48 - 40)) / SEEDS)
    assert noise.extra.interval is not None
    assert ("noise", 4) not in {(t.axis, t.severity) for t in found.condition_comparison.losses}
    sentences = findings(found)
    assert not any("nan" in sentence for sentence in sentences)
    assert any("noise (80 % to 20 % at 28 dB PSNR)" in s for s in sentences if s.startswith("merged"))
    merged = next(m for m in words.heat_maps(found) if m.policy == "merged")
    assert dict(merged.rows)["noise@4: 18.4 dB PSNR"] == (None, None, None)
