"""Comparison of two runs: what counts as worse, and what may not be compared."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from robogauntlet.results.analysis.comparison import (
    COLUMNS,
    Difference,
    Run,
    Verdict,
    compare_runs,
    regression_question,
)
from robogauntlet.results.report.comparison import as_json, as_markdown, as_text, render
from robogauntlet.results.run_document import Provenance
from robogauntlet.results.statistics.pairs import Pairs, mcnemar_worse, pooled
from robogauntlet.suites.episode import SuccessRule
from tests.results.synthetic import cells, document, row

ALPHA = 0.05
TASKS = ("maniskill/A", "pybullet/B", "robosuite/C")


def run(name, success, /, *, of=None, digest=None, drop=(), errors=(), moved=False, **changes):
    """A run whose episode succeeds if `success(cell, seed)`."""
    own = cells(("p",), TASKS) if of is None else of
    rows = []
    for cell in own:
        for seed in range(60):
            if (cell.task, seed) in drop:
                continue
            status = "error" if (cell.task, seed) in errors else "success" if success(cell, seed) else "failure"
            more = {"state_hash": f"{cell.task}{seed}{moved}"} if status != "error" else {}
            made = row(cell, seed, status, **more)
            values = {column: getattr(made, column) for column in COLUMNS}
            rows.append(values | {"policy_digest": digest or cell.policy_digest})
    plan = document(60, own, **changes)
    return Run(name, plan, pd.DataFrame(rows, columns=list(COLUMNS)))


def always(cell, seed):
    return seed % 4 != 0


def worse_in_b(cell, seed):
    return always(cell, seed) and not (cell.task == "pybullet/B" and seed % 4 == 1)


def test_equal_runs_give_no_evidence_of_a_change():
    found = compare_runs(run("new", always), run("old", always))
    assert found.verdict is Verdict.NO_EVIDENCE
    (one,) = found.comparisons
    assert one.is_same_policy
    assert one.overall.no_worse
    assert {line.adjusted for line in one.contrasts} == {line.opposite for line in one.contrasts} == {1.0}


def test_a_task_that_became_worse_is_named_and_the_others_are_not():
    found = compare_runs(run("new", worse_in_b, digest="other"), run("old", always))
    assert found.verdict is Verdict.REGRESSED
    (one,) = found.comparisons
    assert not one.is_same_policy
    assert [line.task for line in one.tasks if line.adjusted <= ALPHA] == ["pybullet/B"]
    (worse,) = (line for line in one.tasks if line.task == "pybullet/B")
    assert worse.pairs == Pairs(both=30, first_only=0, second_only=15, neither=15)
    assert worse.difference.value == pytest.approx(-0.25)
    assert not one.overall.no_worse


def test_the_reverse_is_an_improvement():
    assert compare_runs(run("new", always), run("old", worse_in_b)).verdict is Verdict.IMPROVED


def test_what_became_worse_outweighs_what_became_better():
    def better_in_c(cell, seed):
        return cell.task == "robosuite/C" or worse_in_b(cell, seed)

    assert compare_runs(run("new", better_in_c), run("old", always)).verdict is Verdict.REGRESSED


def test_errors_and_unpaired_episodes_are_in_no_pair_and_are_counted():
    new = run("new", always, errors={("maniskill/A", 3)}, drop={("pybullet/B", 0), ("pybullet/B", 1)})
    found = compare_runs(new, run("old", always))
    assert found.comparisons[0].overall.pairs.trials == 177
    assert found.errors == {"p": (1, 0)}
    assert found.unpaired == {"p": (0, 3)}


def test_runs_that_count_success_by_different_rules_are_not_compared_and_told_so():
    once = [replace(cell, protocol=replace(cell.protocol, success=SuccessRule.ONCE)) for cell in cells(("p",), TASKS)]
    found = compare_runs(run("new", always, of=once, success="once"), run("old", always), allowed=set(Difference))
    assert found.verdict is Verdict.NOT_COMPARABLE
    assert "the suite has success_rule once, the baseline held" in as_text(found)


def test_without_a_shared_episode_runs_are_not_comparable():
    found = compare_runs(run("new", always, of=cells(("p",), TASKS[:1])), run("old", always, of=cells(("q",), TASKS)))
    assert found.verdict is Verdict.NOT_COMPARABLE
    (reason,) = (line for line in as_text(found).splitlines() if line.startswith("- "))
    assert reason.startswith("- new and old share no episode of a policy of the same name; the suite plans other")
    assert reason.endswith("or compare two policies: RUN:A RUN:B")


@pytest.mark.parametrize(
    ("new", "old", "name"),
    [
        ({"name": "other"}, {}, Difference.SUITE),
        ({"of": cells(("p",), TASKS[:2])}, {}, Difference.SUITE),
        (
            {"provenance": Provenance(packages={"sapien": "3.0.4", "ray": "3"})},
            {"provenance": Provenance(packages={"sapien": "3.0.3", "ray": "2"})},
            Difference.SIMULATOR,
        ),
        (
            {"provenance": Provenance(definitions={"gymnasium/Mine": "b"})},
            {"provenance": Provenance(definitions={"gymnasium/Mine": "a"})},
            Difference.SIMULATOR,
        ),
        ({"render_devices": {"robosuite": "A"}}, {"render_devices": {"robosuite": "B"}}, Difference.RENDERER),
        ({"moved": True}, {}, Difference.WORLD),
    ],
)
def test_runs_that_differ_in_more_than_policies_are_not_compared_unless_it_is_allowed(new, old, name):
    sides = run("new", always, **new), run("old", always, **old)
    found = compare_runs(*sides)
    assert found.verdict is Verdict.NOT_COMPARABLE
    assert list(found.differences) == [name]
    assert f"--allow {name}" in as_text(found)
    allowed = compare_runs(*sides, allowed=frozenset({name}))
    assert allowed.verdict is Verdict.NO_EVIDENCE
    assert f"{name} differs" in as_text(allowed)


def test_packages_that_are_no_simulators_may_differ():
    sides = [run("r", always, provenance=Provenance(packages={"ray": version})) for version in "12"]
    assert compare_runs(*sides).differences == {}


def simulated(generator, worse, better, pairs, tasks=1):
    """Counts of pairs, from the probabilities that only the baseline and only the run succeeds."""
    for _ in range(tasks):
        lost, won, rest = generator.multinomial(pairs, [worse, better, 1 - worse - better])
        yield Pairs(rest, int(won), int(lost), 0)


def adjusted(night, test=mcnemar_worse):
    return regression_question(ALPHA).adjusted([night], test)[0]


def family(strata):
    strata = list(strata)
    return [*strata, pooled(strata)] if len(strata) > 1 else strata


@pytest.mark.parametrize(("pairs", "tasks", "disagree"), [(100, 9, 0.2), (155, 1, 0.2)])
def test_without_a_change_at_most_one_run_in_twenty_raises_an_alarm(pairs, tasks, disagree):
    generator = np.random.default_rng(0)
    chance = disagree / 2
    nights = (family(simulated(generator, chance, chance, pairs, tasks)) for _ in range(1000))
    assert sum(min(adjusted(night)) <= ALPHA for night in nights) <= 50


def test_a_drop_of_ten_points_in_155_pairs_is_found_in_four_of_five_runs():
    generator = np.random.default_rng(0)
    nights = (list(simulated(generator, 0.15, 0.05, 155)) for _ in range(1000))
    assert sum(adjusted(night)[0] <= ALPHA for night in nights) >= 800


@pytest.fixture
def regressed():
    return compare_runs(run("new|run", worse_in_b, digest="other"), run("old", always))


def test_the_text_has_task_difference_and_p_value(regressed):
    lines = as_text(regressed).splitlines()
    assert lines[0] == "REGRESSED: new|run against old"
    assert lines[1].startswith("- p, pybullet/B: 75 % before, 50 % now of 60 episodes, -25.0 [")
    assert lines[2].startswith("- p, all tasks: ")


def test_a_policy_that_did_not_change_but_acts_differently_is_reported():
    new, old = run("new", always), run("old", always)
    new.rows.loc[5, "actions_hash"] = "another"
    line = "not changed, but other actions in 1 of 180 episodes"
    assert f"{line}: the program or a library changed" in as_text(compare_runs(new, old))
    now, before, older, other = (
        replace(one, document=one.document.model_copy(update={"provenance": Provenance(processor=processor)}))
        for one, processor in ((new, "a (family 5)"), (old, "a (family 4)"), (old, "a"), (old, "a 4"))
    )
    for one, name in ((before, "a (family 4)"), (other, "a 4")):
        why = f"the processor ({name} before, a (family 5) now) or the program changed"
        assert f"{line}: {why}" in as_text(compare_runs(now, one))
    for unknown in (old, older):
        assert f"{line}: the program or a library" in as_text(compare_runs(now, unknown)), "that is no reason"


def test_markdown_keeps_names_harmless_and_has_a_table_per_policy(regressed):
    text = as_markdown(regressed)
    assert text.startswith("### ❌ REGRESSED: new\\|run against old")
    assert "| pybullet/B | 60 | 75 % | 50 % |" in text


def test_json_holds_what_was_counted(regressed):
    plain = json.loads(as_json(regressed))
    assert plain["verdict"] == "regressed"
    assert plain["comparisons"][0]["tasks"][1]["pairs"] == {
        "both": 30,
        "first_only": 0,
        "second_only": 15,
        "neither": 15,
    }


@pytest.mark.parametrize("name", ["text", "markdown", "json"])
def test_every_format_says_that_runs_are_not_comparable(name):
    found = compare_runs(run("new", always, name="other"), run("old", always))
    assert "suite" in render(found, name)
