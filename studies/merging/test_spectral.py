"""TSV, KnOTS and WUDI on matrices."""

import math

import pytest
import torch
from hypothesis import given, settings

from robogauntlet_mergevla.merging.elementwise import task_arithmetic
from robogauntlet_mergevla.merging.errors import OutOfRange
from robogauntlet_mergevla.merging.merge import merge, merge_task_vectors, operator_names
from robogauntlet_mergevla.merging.recipe import MaskRule, Recipe
from studies.merging.spectral import knots, task_singular_vectors, wudi
from tests.errors import one_line_error
from tests.mergevla.merging.strategies import close, copied, equal, random_task_vectors, task_vectors


def test_tsv_recovers_orthogonal_deltas_of_low_rank():
    generator = torch.Generator().manual_seed(0)
    left = torch.linalg.qr(torch.randn(24, 24, generator=generator, dtype=torch.float64)).Q
    right = torch.linalg.qr(torch.randn(30, 30, generator=generator, dtype=torch.float64)).Q
    deltas = [
        (left[:, i : i + 3] * torch.tensor([3.0, 2.0, 0.5], dtype=torch.float64) @ right[i : i + 3]).float()
        for i in (0, 3, 6)
    ]
    merged = task_singular_vectors({f"expert{i}": {"w": delta} for i, delta in enumerate(deltas)})
    torch.testing.assert_close(merged["w"], sum(deltas), rtol=1e-5, atol=1e-5)


def test_tsv_keeps_as_many_triplets_as_the_matrix_has_for_all_experts_together():
    experts = random_task_vectors(3, shape=(9, 12))
    merged = task_singular_vectors(experts)["w"].double()
    kept = [torch.linalg.svdvals(vector["w"].double())[:3] for vector in experts.values()]
    # The left and right vectors are orthonormal, so the kept values are those of the result.
    expected = torch.cat(kept).sort(descending=True).values
    torch.testing.assert_close(torch.linalg.svdvals(merged), expected, rtol=1e-5, atol=1e-5)


def test_knots_leaves_out_singular_values_up_to_its_cutoff():
    values = torch.tensor([2.0, 1.0, 0.5])
    merged = knots({"expert": {"w": torch.diag(values)}}, cutoff=0.5)["w"]
    torch.testing.assert_close(merged, torch.diag(torch.tensor([2.0, 1.0, 0.0])))


SPECTRAL = pytest.mark.parametrize("operator", [task_singular_vectors, knots, wudi])


@SPECTRAL
def test_spectral_operators_sum_weights_that_are_no_matrices(operator):
    experts = random_task_vectors(3)
    assert torch.equal(operator(experts)["b"], task_arithmetic(experts)["b"])


@SPECTRAL
def test_a_convolution_is_merged_as_the_matrix_of_its_outputs_by_all_its_inputs(operator):
    flat = random_task_vectors(3, shape=(6, 36))
    convolutions = {e: {"w": v["w"].reshape(6, 4, 3, 3)} for e, v in flat.items()}
    merged = operator(convolutions)["w"]
    assert merged.shape == (6, 4, 3, 3)
    assert torch.equal(merged.flatten(1), operator({e: {"w": v["w"]} for e, v in flat.items()})["w"])


@settings(max_examples=25)
@given(experts=task_vectors(min_experts=2))
def test_knots_as_mergevla_codes_it_is_task_arithmetic_up_to_the_cut_off(experts):
    cutoff = 1e-4
    coded, plain = knots(experts, cutoff=cutoff), task_arithmetic(experts)
    lost = torch.linalg.matrix_norm((coded["block.weight"] - plain["block.weight"]).double(), 2)
    # U S [V_1 .. V_M] loses at most the cut-off in spectral norm; summing M blocks multiplies that by sqrt M at most.
    assert lost <= cutoff * math.sqrt(len(experts)) + 1e-5
    assert torch.equal(coded["block.bias"], plain["block.bias"])


def interference(merged, experts):
    return sum(
        ((merged["w"] - vector["w"]) @ vector["w"].T).square().sum().item() / vector["w"].square().sum().item()
        for vector in experts.values()
    )


def test_wudi_has_the_least_interference_that_is_possible():
    experts = random_task_vectors(3, scale=0.05)
    deltas = [vector["w"].double() for vector in experts.values()]
    grams = [delta.T @ delta / delta.square().sum() for delta in deltas]
    # Setting the gradient to zero: tau sum_m G_m = sum_m tau_m G_m.
    least = sum(delta @ gram for delta, gram in zip(deltas, grams, strict=True)) @ torch.linalg.pinv(sum(grams))
    found = interference(wudi(experts, cutoff=0.0), experts)
    assert found == pytest.approx(interference({"w": least.float()}, experts), rel=1e-4)
    assert found < interference(task_arithmetic(experts), experts)


def test_wudi_leaves_the_sum_where_no_expert_writes_much():
    experts = {"a": {"w": torch.diag(torch.tensor([1.0, 1e-3]))}, "b": {"w": torch.diag(torch.tensor([1.0, 2e-3]))}}
    torch.testing.assert_close(wudi(experts)["w"], torch.diag(torch.tensor([1.0, 3e-3])))


OPERATORS = ("tsv", "knots", "wudi")


def run(operator, experts):
    return merge_task_vectors(operator, experts)


@pytest.mark.parametrize("operator", OPERATORS)
def test_the_operators_are_found_by_their_names_and_work_with_every_mask_rule(operator):
    experts = random_task_vectors(3)
    before = copied(experts)
    assert operator in operator_names()
    for rule in MaskRule:
        assert all(torch.isfinite(d).all() for d in merge(experts, Recipe(operator, masks=rule)).of("expert1").values())
    assert equal(run(operator, experts), run(operator, experts))
    assert all(equal(before[expert], experts[expert]) for expert in experts)


@pytest.mark.parametrize("operator", OPERATORS)
def test_they_do_not_depend_on_the_order_of_the_experts_beyond_rounding(operator):
    experts = random_task_vectors(3)
    assert close(run(operator, experts), run(operator, dict(reversed(experts.items()))))


@pytest.mark.parametrize("operator", OPERATORS)
def test_zero_deltas_merge_to_zero(operator):
    zeros = {e: {n: torch.zeros_like(d) for n, d in v.items()} for e, v in random_task_vectors(3).items()}
    assert all(not delta.any() for delta in run(operator, zeros).values())


@pytest.mark.parametrize("operator", ["knots", "wudi"])
def test_an_expert_that_changed_nothing_changes_nothing(operator):
    experts = {expert: {"w": vector["w"]} for expert, vector in random_task_vectors(2).items()}
    assert close(run(operator, experts), run(operator, {**experts, "idle": {"w": torch.zeros(6, 8)}}))


@settings(max_examples=25)
@given(experts=task_vectors(max_experts=1))
def test_one_expert_merges_to_itself_under_wudi(experts):
    assert equal(wudi(experts), experts["expert0"])


@settings(max_examples=25)
@given(experts=task_vectors(max_experts=1))
def test_one_expert_merges_to_itself_under_tsv_but_for_rounding(experts):
    assert close(task_singular_vectors(experts), experts["expert0"], 1e-4)


@settings(max_examples=25)
@given(experts=task_vectors(max_experts=1))
def test_one_expert_merges_to_itself_under_knots_but_for_the_cut_off(experts):
    assert close(knots(experts, cutoff=0.0), experts["expert0"])
    lost = (knots(experts, cutoff=0.5)["block.weight"] - experts["expert0"]["block.weight"]).double()
    assert torch.linalg.matrix_norm(lost, 2) <= 0.5 + 1e-5


@pytest.mark.parametrize("operator", ["tsv", "wudi"])
@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_deltas_whose_squares_leave_fp32_are_merged(operator, scale):
    deltas = random_task_vectors(1, scale=scale)
    torch.testing.assert_close(run(operator, deltas)["w"], deltas["expert0"]["w"], rtol=1e-4, atol=1e-5 * scale)


@pytest.mark.parametrize(("operator", "cutoff"), [("knots", -1.0), ("wudi", 1.0)])
def test_a_cutoff_out_of_range_is_refused_in_one_line(operator, cutoff):
    with one_line_error(OutOfRange, "^expected cutoff .*got "):
        merge_task_vectors(operator, random_task_vectors(2), options={"cutoff": cutoff})
