"""TSV, KnOTS and WUDI on matrices."""

import math

import pytest
import torch
from hypothesis import given, settings

from robogauntlet.policies.mergevla.merging.elementwise import mean, task_arithmetic
from robogauntlet.policies.mergevla.merging.spectral import knots, task_singular_vectors, wudi
from tests.policies.mergevla.merging.strategies import random_task_vectors, task_vectors


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


@pytest.mark.parametrize("operator", [task_singular_vectors, wudi])
def test_spectral_operators_average_weights_that_are_no_matrices(operator):
    experts = random_task_vectors(3)
    assert torch.equal(operator(experts)["b"], mean(experts)["b"])


@settings(max_examples=25)
@given(experts=task_vectors(min_experts=2))
def test_knots_as_mergevla_codes_it_is_task_arithmetic_up_to_the_cut_off(experts):
    cutoff = 1e-4
    coded, plain = knots(experts, aligned="sum", cutoff=cutoff), task_arithmetic(experts)
    lost = torch.linalg.matrix_norm((coded["block.weight"] - plain["block.weight"]).double(), 2)
    # U S [V_1 .. V_M] loses at most the cut-off in spectral norm; summing M blocks multiplies that by sqrt M at most.
    assert lost <= cutoff * math.sqrt(len(experts)) + 1e-5
    assert torch.equal(coded["block.bias"], plain["block.bias"])


def test_knots_as_published_elects_signs_in_the_shared_space():
    # Both experts write along one output direction, so that the aligned part is one row, and TIES decides on it.
    direction = torch.tensor([[0.6], [0.8]])
    a, b = torch.tensor([[3.0, 1.0, -2.0]]), torch.tensor([[1.0, -4.0, -2.0]])
    experts = {"a": {"w": direction @ a}, "b": {"w": direction @ b}}
    torch.testing.assert_close(knots(experts)["w"], direction @ torch.tensor([[4.0, -4.0, -4.0]]))


def interference(merged, experts):
    return sum(
        ((merged["w"] - vector["w"]) @ vector["w"].T).square().sum().item() / vector["w"].square().sum().item()
        for vector in experts.values()
    )


def test_wudi_lowers_the_interference_that_it_is_defined_by():
    experts = random_task_vectors(3, scale=0.05)
    start = interference(task_arithmetic(experts), experts)
    assert interference(wudi(experts), experts) < start
    assert torch.equal(wudi(experts, steps=0)["w"], task_arithmetic(experts)["w"])


def test_wudi_with_enough_steps_reaches_the_least_interference():
    experts = random_task_vectors(3, scale=0.05)
    deltas = [vector["w"].double() for vector in experts.values()]
    grams = [delta.T @ delta / delta.square().sum() for delta in deltas]
    # Setting the gradient to zero: tau sum_m G_m = sum_m tau_m G_m.
    least = sum(delta @ gram for delta, gram in zip(deltas, grams, strict=True)) @ torch.linalg.pinv(sum(grams))
    found = interference(wudi(experts, steps=1000, learning_rate=1e-3), experts)
    assert found == pytest.approx(interference({"w": least.float()}, experts), rel=0.01)
