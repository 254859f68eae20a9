"""Properties of every merge operator, and known values of each."""

import math
from importlib import metadata
from importlib.metadata import EntryPoint, EntryPoints
from itertools import permutations

import pytest
import torch
from hypothesis import given, settings, strategies as st

from robogauntlet.policies.contract import PolicyError
from robogauntlet_mergevla.merging.elementwise import (
    dare,
    emr,
    emr_modulators,
    mean,
    task_arithmetic,
    ties,
    ties_published,
)
from robogauntlet_mergevla.merging.errors import ExpertsDiffer, OutOfRange
from robogauntlet_mergevla.merging.merge import (
    OPERATORS,
    PLUGINS,
    UnknownOperator,
    check_operator,
    merge_task_vectors,
    operator_names,
)
from tests.errors import one_line_error
from tests.mergevla.merging.strategies import close, copied, equal, random_task_vectors, task_vectors

ORDER_FREE = ("mean", "ta", "ties", "ties-published", "emr")
PUBLISHED = {"mean", "ta", "ties", "ties-published", "dare", "emr"}
SIGNLESS = {"magnitude", "flat"}
"""Merge magnitudes only, see `test_signs`."""
every_operator = pytest.mark.parametrize("operator", OPERATORS)


def run(operator, experts):
    return merge_task_vectors(operator, experts)


def row(*entries):
    """An expert with one vector."""
    return {"w": torch.tensor(entries, dtype=torch.float32)}


# Of all operators


@every_operator
@settings(max_examples=15)
@given(experts=task_vectors(grid=True))
def test_results_are_fp32_of_the_same_shapes_and_deterministic_and_arguments_are_unchanged(operator, experts):
    before = copied(experts)
    merged = run(operator, experts)
    assert all(equal(before[expert], experts[expert]) for expert in before)
    first = experts["expert0"]
    assert merged.keys() == first.keys()
    assert all(merged[n].dtype == torch.float32 and merged[n].shape == first[n].shape for n in first)
    assert all(torch.isfinite(delta).all() for delta in merged.values())
    assert equal(merged, run(operator, experts))
    for delta in merged.values():  # a result that shares memory with an argument could modify it later
        delta.add_(1.0)
    assert all(equal(before[expert], experts[expert]) for expert in before)


@every_operator
@settings(max_examples=15)
@given(experts=task_vectors(max_experts=3))
def test_zero_deltas_merge_to_zero(operator, experts):
    zeros = {expert: {n: torch.zeros_like(d) for n, d in vector.items()} for expert, vector in experts.items()}
    assert all(not delta.any() for delta in run(operator, zeros).values())


@pytest.mark.parametrize("operator", ["ta", "ties", "ties-published", "dare", "emr"])
def test_an_expert_that_changed_nothing_changes_nothing(operator):
    # Not so for the mean, where the number of experts counts.
    experts = {expert: {"w": vector["w"]} for expert, vector in random_task_vectors(2).items()}
    assert close(run(operator, experts), run(operator, {**experts, "idle": {"w": torch.zeros(6, 8)}}))


@pytest.mark.parametrize("operator", ORDER_FREE)
@settings(max_examples=25)
@given(data=st.data(), experts=task_vectors(min_experts=2))
def test_does_not_depend_on_the_order_of_the_experts_to_the_last_bit(operator, data, experts):
    shuffled = data.draw(st.permutations(list(experts.values())))
    permuted = dict(zip(experts, shuffled, strict=True))
    assert equal(run(operator, experts), run(operator, permuted))


@pytest.mark.parametrize("operator", ORDER_FREE)
def test_a_sum_that_cancels_does_not_depend_on_the_order_either(operator):
    # Added one by one, 1 + 1e-20 - 1 is 0 and 1 - 1 + 1e-20 is not, which would flip an elected sign.
    orders = [run(operator, {str(i): row(x, -1) for i, x in enumerate(p)}) for p in permutations((1, 1e-20, -1))]
    assert all(equal(orders[0], other) for other in orders)


@pytest.mark.parametrize("operator", ["mean", "ta", "ties", "emr"])
@settings(max_examples=25)
@given(experts=task_vectors(max_experts=1))
def test_one_expert_merges_to_itself(operator, experts):
    assert equal(run(operator, experts), experts["expert0"])


def test_one_expert_does_not_merge_to_itself_under_dare_unless_nothing_is_dropped():
    experts = random_task_vectors(1)
    assert not close(dare(experts), experts["expert0"])
    assert equal(dare(experts, drop=0.0), experts["expert0"])


@pytest.mark.parametrize("operator", sorted(OPERATORS.keys() - {"dare", "ties-published"} - SIGNLESS))
@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_deltas_whose_squares_leave_fp32_are_merged(operator, scale):
    deltas = random_task_vectors(1, scale=scale)
    merged = merge_task_vectors(operator, deltas)["w"]
    torch.testing.assert_close(merged, deltas["expert0"]["w"], rtol=1e-4, atol=1e-5 * scale)


@every_operator
def test_alpha_scales_the_result(operator):
    experts = random_task_vectors(3)
    half = merge_task_vectors(operator, experts, alpha=0.5)
    assert all(torch.equal(half[n], delta * 0.5) for n, delta in run(operator, experts).items())


def test_the_registry_has_every_operator_and_cannot_be_changed():
    assert set(OPERATORS) == PUBLISHED | SIGNLESS
    with pytest.raises(TypeError):
        OPERATORS["ta"] = OPERATORS["mean"]  # type: ignore[index]


# Of each


def test_mean_and_task_arithmetic_have_known_values():
    experts = {"a": row(1, -2, 0), "b": row(3, 4, 0)}
    assert mean(experts)["w"].tolist() == [2, 1, 0]
    assert task_arithmetic(experts)["w"].tolist() == [4, 2, 0]


def test_ties_has_known_values():
    # Sums 4, -2, 0, 0, 2: signs + - 0 0 +, the majority is +, so both zeros become +.
    experts = {"a": row(1, 3, 2, 0, 3), "b": row(3, -5, -2, 0, -1)}
    assert ties(experts)["w"].tolist() == [4, -5, 2, 0, 3]


def test_ties_elects_the_majority_over_all_weights_where_a_sum_is_zero():
    experts = {
        "a": {"w": torch.tensor([2.0]), "other": torch.tensor([-1.0, -1.0])},
        "b": {"w": torch.tensor([-2.0]), "other": torch.tensor([0.0, -3.0])},
    }
    assert ties(experts)["w"].tolist() == [-2]


def test_ties_trims_the_smallest_entries_of_an_expert_over_all_its_weights():
    experts = {
        "a": {"w": torch.tensor([1.0, -4.0]), "v": torch.tensor([2.0, 3.0])},
        "b": {"w": torch.tensor([10.0, 1.0]), "v": torch.tensor([20.0, 30.0])},
    }
    merged = ties(experts, trim=0.5)  # leaves -4 and 3 of a, 20 and 30 of b
    assert merged["w"].tolist() == [0, -4]
    assert merged["v"].tolist() == [20, 33]


def test_ties_as_published_has_known_values():
    # Of five entries each keeps one (or two with equal magnitudes). Sums 0, -9, 3, 0, -2 elect +, -, +, +, -.
    experts = {"a": row(1, -4, 2, 0, 0), "b": row(0, -5, 1, 0, -1), "c": row(0, 1, 3, 0, -2)}
    assert ties_published(experts)["w"].tolist() == [0, -4.5, 3, 0, 0]
    assert ties_published(experts, trim=0.0)["w"].tolist() == [1, -4.5, 2, 0, -1.5]


@settings(max_examples=25)
@given(experts=task_vectors(grid=True), trim=st.floats(0, 0.99))
def test_ties_sums_only_agreeing_deltas(experts, trim):
    merged = ties(experts, trim=trim)
    for name, delta in merged.items():
        magnitude = sum(vector[name].abs() for vector in experts.values())
        assert torch.all(delta.abs() <= magnitude)
        assert torch.all((delta == 0) | torch.stack([vector[name] * delta > 0 for vector in experts.values()]).any(0))


def test_emr_has_known_values():
    # Sums 4, -2, 0, 5. Masks: a agrees at 0 and 3, b everywhere but at the zero.
    experts = {"a": row(1, 3, 2, 4), "b": row(3, -5, -2, 1)}
    merged = emr(experts)
    assert merged["w"].tolist() == [3, -5, 0, 4]
    masks, rescalers = emr_modulators(experts, merged)
    assert masks["a"]["w"].tolist() == [True, False, False, True]
    assert masks["b"]["w"].tolist() == [True, True, False, True]
    assert rescalers == pytest.approx({"a": 10 / 7, "b": 11 / 12})


def test_emr_takes_the_greatest_magnitude_of_those_that_agree_even_if_another_is_greater():
    assert emr({"a": row(5), "b": row(-3), "c": row(-4)})["w"].tolist() == [-4]


def test_emr_rescalers_of_experts_that_changed_nothing_are_one():
    experts = {"a": row(0, 0), "b": row(1, -1)}
    assert emr_modulators(experts, emr(experts))[1]["a"] == 1.0


def test_dare_is_task_arithmetic_in_expectation():
    experts = random_task_vectors(2, shape=(40, 50))
    draws, drop = 200, 0.8
    average = sum(dare(experts, drop=drop, seed=seed)["w"].double() for seed in range(draws)) / draws
    # Each entry's variance is that of a rescaled coin, sum_m tau_m² drop / (1 - drop), over the number of draws.
    variance = sum(vector["w"].double().square() for vector in experts.values()) * drop / (1 - drop) / draws
    z = (average - task_arithmetic(experts)["w"].double()) / variance.sqrt()
    assert abs(z.mean()) < 4 / math.sqrt(z.numel())
    assert 0.9 < z.std() < 1.1


def test_dare_drops_the_given_share():
    kept = dare(random_task_vectors(1, shape=(200, 200)), drop=0.9)["w"] != 0
    assert abs(kept.double().mean() - 0.1) < 4 * math.sqrt(0.09 / kept.numel())


def test_dare_drops_other_entries_of_each_expert_and_weight():
    ones = {"w": torch.ones(50), "v": torch.ones(50)}
    a, b = dare({"a": ones}, drop=0.5), dare({"b": ones}, drop=0.5)
    assert not torch.equal(a["w"], b["w"])
    assert not torch.equal(a["w"], a["v"])


def test_what_dare_drops_of_an_expert_does_not_depend_on_the_others():
    experts = random_task_vectors(2)
    alone = {expert: dare({expert: vector}) for expert, vector in experts.items()}
    assert close(dare(experts), task_arithmetic(alone))
    assert not equal(dare(experts), dare(experts, seed=1))


# Bad input


@pytest.mark.parametrize(
    ("operator", "options"),
    [
        ("ties", {"trim": 1.0}),
        ("ties", {"trim": -0.1}),
        ("ties", {"trim": "half"}),
        ("dare", {"drop": 1.0}),
        ("dare", {"drop": math.nan}),
        ("dare", {"seed": 0.5}),
        ("ties-published", {"trim": 1.0}),
    ],
)
def test_options_out_of_range_are_refused_in_one_line(operator, options):
    with one_line_error(OutOfRange, f"^expected {next(iter(options))} .*got "):
        merge_task_vectors(operator, random_task_vectors(2), options=options)


@pytest.mark.parametrize("alpha", [0.0, -1.0, math.inf, math.nan])
def test_an_alpha_out_of_range_is_refused(alpha):
    with pytest.raises(OutOfRange, match="alpha"):
        merge_task_vectors("ta", random_task_vectors(2), alpha=alpha)


def test_another_distribution_adds_operators_by_an_entry_point(monkeypatch):
    added = EntryPoint("first", f"{__name__}:first_expert", PLUGINS)
    monkeypatch.setattr(metadata, "entry_points", lambda **given: EntryPoints([added]).select(**given))
    experts = random_task_vectors(2)
    assert operator_names()[-1] == "first"
    assert equal(
        merge_task_vectors("first", experts, options={"scale": 2.0}), {n: 2 * d for n, d in experts["expert0"].items()}
    )
    with pytest.raises(UnknownOperator, match="operator 'first' has no option 'trim'; it has: scale"):
        check_operator("first", ["trim"])


def first_expert(task_vectors, *, scale=1.0):
    """An operator."""
    return {name: scale * delta for name, delta in next(iter(task_vectors.values())).items()}


def test_unknown_operators_and_options_are_refused():
    with pytest.raises(UnknownOperator, match="unknown merge operator 'tie'; did you mean 'ties'"):
        check_operator("tie")
    with pytest.raises(UnknownOperator, match="operator 'ta' has no option 'trim'; it has: none"):
        merge_task_vectors("ta", random_task_vectors(2), options={"trim": 0.5})


@every_operator
@pytest.mark.parametrize(
    ("vector", "message"),
    [
        ({"w": torch.zeros(6, 8)}, "weight b is missing"),
        ({"w": torch.zeros(6, 8), "b": torch.zeros(6), "c": torch.zeros(1)}, "weight c is unexpected"),
        ({"w": torch.zeros(8, 6), "b": torch.zeros(6)}, r"weight w: expected shape \(6, 8\), got \(8, 6\)"),
        ({"w": torch.zeros(6, 8).bfloat16(), "b": torch.zeros(6)}, "expected torch.float32, got torch.bfloat16"),
        ({"w": torch.full((6, 8), math.nan), "b": torch.zeros(6)}, "expected finite numbers"),
    ],
)
def test_experts_that_differ_are_refused_in_one_line(operator, vector, message):
    with one_line_error(ExpertsDiffer, message) as refusal:
        run(operator, {**random_task_vectors(1), "odd": vector})
    assert isinstance(refusal.value, PolicyError)
    assert "odd" in str(refusal.value)


@every_operator
def test_no_experts_are_refused(operator):
    with pytest.raises(ExpertsDiffer, match="at least one"):
        run(operator, {})
