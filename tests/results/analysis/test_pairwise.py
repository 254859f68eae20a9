"""Policies against each other: what is paired, what is left out, and the algebra of the differences."""

import pytest
from hypothesis import given, settings, strategies as st

from robogauntlet.results.analysis import pairwise
from robogauntlet.results.analysis.comparison import Difference, Run
from robogauntlet.results.analysis.pairwise import COLUMNS, NotComparable, PolicyRows, compare_all, compare_policies
from robogauntlet.results.run_document import Provenance, RunError, RunStatus
from robogauntlet.results.statistics.multiplicity import holm
from robogauntlet.results.statistics.pairs import Pairs, detectable_drop, mcnemar
from robogauntlet.suites.episode import Cell, Condition, Protocol, SuccessRule, View
from tests.results.synthetic import cells, columns_of, document, row

TASKS = ("maniskill/A", "maniskill/B", "pybullet/C")
SEEDS = 8


def run(outcome, policies=("a", "b"), name="run", seeds=range(SEEDS), of=None, moved=False, **changes):
    """A run whose episode ends as `outcome(cell, seed)` says: success, failure, error, or None for not played."""
    plan = cells(policies, TASKS) if of is None else of
    played = [(cell, seed, outcome(cell, seed)) for cell in plan for seed in seeds]
    rows = [
        row(cell, seed, status, **({"state_hash": "moved"} if moved else {}))
        for cell, seed, status in played
        if status is not None
    ]
    return Run(name, document(len(seeds), plan, **changes), columns_of(rows, COLUMNS))


def always(cell, seed):
    return "success"


def b_fails_in_c(cell, seed):
    return "failure" if (cell.policy, cell.task) == ("b", "pybullet/C") else "success"


def against(first, second, **options):
    """Compares two (run, policy)."""
    (one,) = compare_policies(PolicyRows.of_run(*first), PolicyRows.of_run(*second), **options).comparisons
    return one


STATUS = st.sampled_from(["success", "failure", "error", None])
OUTCOMES = st.lists(STATUS, min_size=6 * SEEDS, max_size=6 * SEEDS)


def drawn_run(drawn):
    """A run of a and b with these outcomes; the first seed of each task has a verdict of both."""
    place = {(cell.policy, cell.task): number * SEEDS for number, cell in enumerate(cells(("a", "b"), TASKS))}
    return run(lambda cell, seed: drawn[place[cell.policy, cell.task] + seed] if seed else "success")


@settings(max_examples=40)
@given(OUTCOMES)
def test_a_policy_does_not_differ_from_itself(drawn):
    played = drawn_run(drawn)
    found = against((played, "a"), (played, "a"))
    assert {(line.difference.value, line.p, line.adjusted) for line in (found.overall, *found.parts)} == {(0, 1, 1)}
    assert found.identical == found.overall.pairs.trials
    assert found.unpaired == (0, 0)


@settings(max_examples=40)
@given(OUTCOMES)
def test_every_verdict_is_in_a_pair_or_counted_as_left_out(drawn):
    played = drawn_run(drawn)
    found = against((played, "a"), (played, "b"))
    for side, policy in enumerate(("a", "b")):
        own = played.rows[played.rows["policy"] == policy]
        assert found.overall.pairs.trials + found.unpaired[side] + found.errors[side] == len(own)


def test_policies_of_two_runs_are_paired():
    good = run(always, ("base",), "old")
    bad = run(lambda cell, seed: "failure" if seed % 2 else "success", ("new",), "today")
    found = against((bad, "new"), (good, "base"))
    assert found.overall.pairs == Pairs(12, 0, 12, 0)
    assert found.overall.detectable == detectable_drop(found.overall.pairs, 0.025)
    assert [(line.simulator, line.task) for line in found.tasks] == [(task.partition("/")[0], task) for task in TASKS]
    assert (found.first.run, found.second.run) == ("today", "old")


def test_a_renamed_policy_is_found_by_its_content():
    played = run(always)
    played.rows["policy"] = played.rows["policy"].replace("a", "an earlier name")
    assert against((played, "a"), (played, "b")).overall.pairs.trials == 3 * SEEDS


def test_an_unfinished_run_is_compared_and_noted():
    played = run(always, status=RunStatus.INTERRUPTED)
    assert against((played, "a"), (played, "b")).differences == {Difference.UNFINISHED: "run is interrupted"}


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"provenance": Provenance(packages={"sapien": "3.0.4"})}, Difference.SIMULATOR),
        ({"render_devices": {"maniskill": "GPU"}}, Difference.RENDERER),
        ({"moved": True}, Difference.WORLD),
    ],
)
def test_runs_that_differ_in_more_than_the_policy_are_compared_only_if_allowed(changes, name):
    old = run(always, ("a",), "old", provenance=Provenance(packages={"sapien": "3.0.3"}))
    old = Run("old", old.document.model_copy(update={"render_devices": {"maniskill": "CPU"}}), old.rows)
    new = run(always, ("b",), "new", **{"provenance": old.document.provenance, **changes})
    with pytest.raises(NotComparable, match=rf"new:b and old:a are not comparable: {name} differs: .* --allow {name} "):
        against((new, "b"), (old, "a"))
    assert set(against((new, "b"), (old, "a"), allowed={name}).differences) == {name}


def protocol_cells(policy, **changes):
    view = View(**{name: changes.pop(name) for name in list(changes) if name in ("image_size", "cameras")})
    protocol = Protocol(**{"horizon": 100, "view": view, **changes})
    return [Cell(policy, policy, "maniskill/A", protocol)]


@pytest.mark.parametrize(
    ("other", "why"),
    [
        ({"of": protocol_cells("b", horizon=200)}, "horizon 100 and 200"),
        ({"of": protocol_cells("b", replan_every=1, image_size=224)}, "replan_every 8 and 1; image_size 96 and 224"),
        ({"of": protocol_cells("b", success=SuccessRule.ONCE)}, "success_rule the protocol's own and once"),
        ({"of": protocol_cells("b"), "seeds": range(100, 120)}, "seeds 0 to 7 and 100 to 119"),
        ({"of": cells(("b",), ("pybullet/C", "pybullet/D"))}, "tasks maniskill/A and pybullet/C, pybullet/D"),
        (
            {"of": protocol_cells("b"), "outcome": lambda *_: "error"},
            "new:b has no clean episode with a verdict, 8 ended in an error",
        ),
    ],
)
def test_policies_without_a_shared_episode_are_told_what_differs(other, why):
    old = run(always, of=protocol_cells("a"), name="old")
    new = run(**{"outcome": always, "name": "new", **other})
    with pytest.raises(NotComparable) as refused:
        against((old, "a"), (new, "b"))
    remedy = "" if why.startswith("new:b has no") else "; play both on the same tasks with the same seeds and protocol"
    assert str(refused.value) == f"old:a and new:b share no episode: {why}{remedy}"


def test_an_unknown_policy_is_refused_with_the_nearest_name():
    with pytest.raises(RunError, match=r"run: the run has no policy 'oracel'; did you mean 'oracle'\?"):
        PolicyRows.of_run(run(always, ("oracle", "b")), "oracel")


def test_without_a_baseline_all_pairs_of_a_few_policies_are_compared_and_have_letters():
    def outcome(cell, seed):
        return "failure" if cell.policy == "bad" else "success"

    found = compare_all(run(outcome, ("good", "too", "bad")))
    names = [(one.first.policy, one.second.policy) for one in found.comparisons]
    assert names == [("good", "too"), ("good", "bad"), ("too", "bad")]
    assert {row.policy: row.letters for row in found.standings} == {"good": "a", "too": "a", "bad": "b"}
    overall = [one.overall for one in found.comparisons]
    assert [line.adjusted for line in overall] == list(holm([line.p for line in overall]))


def test_simulators_and_tasks_of_all_comparisons_are_adjusted_together_if_their_test_can_reach_alpha():
    def outcome(cell, seed):
        fails = {"c": seed < 7, "b": seed < 5 and cell.task == TASKS[0], "a": False}[cell.policy]
        return "failure" if fails else "success"

    parts = [line for one in compare_all(run(outcome, ("a", "b", "c"))).comparisons for line in one.parts]
    tested = [line for line in parts if line.pairs.first_only + line.pairs.second_only > 5]
    assert 0 < len(tested) < len(parts)
    assert [line.adjusted for line in tested] == list(holm([line.p for line in tested]))
    assert {line.adjusted for line in parts if line not in tested} == {1.0}


def test_many_policies_have_letters_instead_of_pairs():
    names = [f"p{number}" for number in range(pairwise.ALL_PAIRS + 1)]
    found = compare_all(run(always, names))
    assert found.comparisons == ()
    assert [row.letters for row in found.standings] == ["a"] * len(names)


def test_the_suite_chooses_the_baseline_and_the_others():
    names = ("base", "b", "c", "d", "e", "f")
    suite = {"compare": {"baseline": "base", "others": ["c", "f"]}}
    found = compare_all(run(always, names, **suite))
    assert found.baseline == "base"
    assert [(one.first.policy, one.second.policy) for one in found.comparisons] == [("c", "base"), ("f", "base")]
    assert found.standings == ()
    assert compare_all(run(always, names, **suite), only=("b", "d", "e")).baseline is None


def test_a_policy_with_errors_only_is_listed_as_not_compared():
    found = compare_all(run(lambda cell, seed: "error" if cell.policy == "c" else "success", ("a", "b", "c")))
    assert [(one.first.policy, one.second.policy) for one in found.comparisons] == [("a", "b")]
    assert len(found.not_compared) == 2
    assert found.not_compared[0].startswith("run:a and run:c share no episode: run:c has no clean episode")


def test_pairs_without_a_common_episode_are_explained_up_to_a_number(monkeypatch):
    names = tuple(f"p{number}" for number in range(30))
    explained, really = [], pairwise._why_none
    monkeypatch.setattr(pairwise, "_why_none", lambda *sides: explained.append(sides) or really(*sides))
    played = run(lambda cell, seed: "success" if cell.policy == names[seed] else None, names, seeds=range(30))
    found = compare_all(played)
    assert len(explained) == pairwise.MOST_NAMED == len(found.not_compared) - 1
    assert found.not_compared[-1] == f"{30 * 29 // 2 - pairwise.MOST_NAMED} more pairs that share no episode"


def test_a_policy_that_a_suite_names_many_times_is_compared_once():
    found = compare_all(run(always, compare={"baseline": "a", "others": ["b"] * 9_999}))
    assert (len(found.comparisons), found.policies) == (1, 2)


def test_a_single_policy_cannot_be_compared():
    with pytest.raises(RunError, match="expected two policies or more to compare, got a"):
        compare_all(run(always, ("a",)))


SHIFTS = (Condition(), Condition("noise", 1), Condition("noise", 3), Condition("blur", 2), Condition("blind", 1))


def b_is_disturbed_by_noise(cell, seed):
    return "failure" if cell.policy == "b" and cell.condition == Condition("noise", 3) else "success"


def test_perturbed_episodes_are_paired_by_their_condition_over_all_tasks():
    played = run(b_is_disturbed_by_noise, of=cells(("a", "b"), TASKS, SHIFTS))
    found = against((played, "a"), (played, "b"))
    assert [str(line.condition) for line in found.conditions] == ["noise@1", "noise@3", "blur@2"]  # no control
    assert [line.pairs for line in found.conditions] == [Pairs(24, 0, 0, 0), Pairs(0, 24, 0, 0), Pairs(24, 0, 0, 0)]
    assert {line.tasks for line in found.conditions} == {3}
    assert found.overall.pairs == Pairs(24, 0, 0, 0)
    disturbed = found.conditions[1]
    assert (disturbed.difference.value, disturbed.p) == (1.0, mcnemar(disturbed.pairs))


def test_severities_of_an_axis_are_adjusted_together_in_all_comparisons_and_without_other_axes():
    def outcome(cell, seed):
        weak = {"b": 4 + cell.condition.severity, "c": 6}.get(cell.policy, 0)
        return "failure" if cell.condition.severity and cell.task == TASKS[0] and seed < weak else "success"

    shifts = (Condition(), *(Condition(axis, severity) for axis in ("noise", "blur") for severity in (1, 2, 3)))
    compared = compare_all(run(outcome, of=cells(("a", "b", "c"), TASKS, shifts))).comparisons
    for axis in ("noise", "blur"):
        lines = [line for one in compared for line in one.conditions if line.axis == axis]
        tested = [line for line in lines if line.pairs.first_only + line.pairs.second_only > 5]
        assert 0 < len(tested) < len(lines)
        assert [line.adjusted for line in tested] == list(holm([line.p for line in tested]))
        assert {line.adjusted for line in lines if line not in tested} == {1.0}


def test_perturbed_errors_and_episodes_that_one_has_not_played_are_counted_as_left_out():
    def outcome(cell, seed):
        if not cell.condition.severity:
            return "success"
        return {"a": "error" if seed == 0 else "success", "b": None if seed < 3 else "failure"}[cell.policy]

    played = run(outcome, of=cells(("a", "b"), TASKS[:1], (Condition(), Condition("noise", 2))))
    found = against((played, "a"), (played, "b"))
    assert found.conditions[0].pairs == Pairs(0, SEEDS - 3, 0, 0)
    assert found.perturbed_left_out == (3, 0)
    assert (found.errors, found.unpaired) == ((0, 0), (0, 0))
