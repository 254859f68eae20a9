"""Signs and row scales of each task, and shared magnitudes."""

from itertools import pairwise

import numpy as np
import pytest
import torch
from hypothesis import given, settings

from robogauntlet_mergevla.merging.diagnostics import mask_statistics
from robogauntlet_mergevla.merging.errors import ExpertsDiffer
from robogauntlet_mergevla.merging.masks import MaskMismatch
from robogauntlet_mergevla.merging.merge import merge
from robogauntlet_mergevla.merging.recipe import MaskRule, Recipe
from robogauntlet_mergevla.merging.signs import apply_signs, fit_signs, flat, magnitude
from tests.mergevla.merging.strategies import close, random_task_vectors, task_vectors


def distance(task_vectors, merged):
    """Sum over experts of the squared distance between an expert's delta after merging and its own vector."""
    return sum(
        (merged.of(e)[n] - d).double().square().sum().item()
        for e, vector in task_vectors.items()
        for n, d in vector.items()
    )


def test_shared_magnitudes_take_the_signs_and_row_scales_of_a_task():
    shared = {"w": torch.tensor([[1.0, -2.0], [3.0, 4.0]])}
    own = {"w": torch.tensor([[-2.0, 4.0], [0.0, -5.0]])}
    signs, row_scales = fit_signs({"a": own}, shared)
    assert signs["a"]["w"].tolist() == [[False, True], [True, False]]
    assert row_scales["a"]["w"].tolist() == pytest.approx([(2 + 8) / 5, 20 / 25])
    delta = apply_signs(shared, signs["a"], row_scales["a"])["w"]
    torch.testing.assert_close(delta, torch.tensor([[-2.0, 4.0], [2.4, -3.2]]))


def test_magnitudes_and_flat_rows_have_known_values():
    experts = {"a": {"w": torch.tensor([[3.0, -4.0], [1.0, 0.0]])}, "b": {"w": torch.tensor([[-6.0, 8.0], [0.0, 0.0]])}}
    torch.testing.assert_close(magnitude(experts)["w"][0], torch.tensor([3.0, 4.0]) * (5 / 2) ** 0.5)
    torch.testing.assert_close(magnitude(experts)["w"][1], torch.tensor([0.5**0.5, 0.0]))
    assert flat(experts)["w"].tolist() == [[5.25, 5.25], [0.25, 0.25]]


@settings(max_examples=25)
@given(experts=task_vectors(max_experts=1))
def test_one_expert_is_unchanged(experts):
    # Up to the rounding of magnitudes to bf16, eight bits.
    assert close(merge(experts, Recipe("magnitude", masks=MaskRule.SIGNS)).of("expert0"), experts["expert0"], 2**-7)


@settings(max_examples=25)
@given(experts=task_vectors(min_experts=2))
def test_no_other_magnitudes_fit_the_experts_better(experts):
    best = distance(experts, merge(experts, Recipe("magnitude", masks=MaskRule.SIGNS)))
    for operator in ("flat", "ties", "emr", "mean"):
        assert best <= distance(experts, merge(experts, Recipe(operator, masks=MaskRule.SIGNS))) * 1.02 + 1e-4


def test_magnitudes_are_nowhere_negative_and_do_not_depend_on_the_order_beyond_rounding():
    experts = random_task_vectors(4)
    magnitudes = magnitude(experts)
    assert all((delta >= 0).all() for delta in magnitudes.values())
    assert close(magnitudes, magnitude(dict(reversed(experts.items()))))


def test_alpha_cancels():
    experts = random_task_vectors(3)
    one, half = (
        merge(experts, Recipe("ties", masks=MaskRule.SIGNS, alpha=alpha)).of("expert1") for alpha in (1.0, 0.5)
    )
    assert close(one, half, 2**-7)


def test_an_expert_that_changed_nothing_gets_no_delta():
    experts = random_task_vectors(2)
    experts["idle"] = {name: torch.zeros_like(delta) for name, delta in experts["expert0"].items()}
    merged = merge(experts, Recipe("magnitude", masks=MaskRule.SIGNS))
    assert not any(delta.any() for delta in merged.of("idle").values())


def test_a_sign_bit_holds_more_than_a_mask_bit_for_unrelated_experts():
    experts = random_task_vectors(9, shape=(64, 64))
    signs = mask_statistics(experts, merge(experts, Recipe("magnitude", masks=MaskRule.SIGNS)))
    masks = mask_statistics(experts, merge(experts, Recipe("ties", masks=MaskRule.TASK)))
    assert min(signs.cosine.values()) > max(masks.cosine.values())
    assert set(signs.keep.values()) == {1.0}
    assert signs.selfish == 0.0


def test_signs_and_row_scales_for_another_model_are_refused_in_one_line():
    shared = {"w": torch.ones(2, 3)}
    signs = {"w": torch.ones(2, 3, dtype=torch.bool)}
    with pytest.raises(MaskMismatch, match="the mask is for another model: weight w: expected shape"):
        apply_signs(shared, {"w": torch.ones(2, 2, dtype=torch.bool)}, {"w": torch.ones(2)})
    with pytest.raises(ExpertsDiffer, match=r"row scales are for another model: weight w: expected shape \(2,\)"):
        apply_signs(shared, signs, {"w": torch.ones(3)})
    with pytest.raises(ExpertsDiffer, match="weight w is missing"):
        apply_signs(shared, signs, {})
    with pytest.raises(ExpertsDiffer, match="does not fit the merged one"):
        fit_signs({"a": {"w": torch.ones(3, 2)}}, shared)


@settings(max_examples=25)
@given(experts=task_vectors(min_experts=2))
def test_every_round_brings_the_task_nearer(experts):
    distances = [
        distance(experts, merge(experts, Recipe("magnitude", masks=MaskRule.SIGNS, rounds=n))) for n in (1, 2, 3)
    ]
    assert all(after <= before * 1.02 + 1e-4 for before, after in pairwise(distances))


def test_two_rounds_are_the_first_and_the_merge_of_its_residuals():
    experts = random_task_vectors(4)
    both, first = (merge(experts, Recipe("magnitude", masks=MaskRule.SIGNS, rounds=n)) for n in (2, 1))
    left = {e: {n: d - first.of(e)[n] for n, d in vector.items()} for e, vector in experts.items()}
    second = merge(left, Recipe("magnitude", masks=MaskRule.SIGNS))
    assert (both.recipe.rounds, first.recipe.rounds) == (2, 1)
    assert close(both.of("expert2"), {n: d + second.of("expert2")[n] for n, d in first.of("expert2").items()})


def test_two_bits_of_unrelated_experts_are_as_near_as_the_second_round_of_one_bit_deltas():
    experts = random_task_vectors(9, shape=(64, 64))
    one, two = (
        mask_statistics(experts, merge(experts, Recipe("flat", masks=MaskRule.SIGNS, rounds=n))).cosine["expert0"]
        for n in (1, 2)
    )
    assert one == pytest.approx((2 / np.pi) ** 0.5, abs=0.01)  # E|x| of a standard normal
    assert two == pytest.approx((1 - (1 - 2 / np.pi) * (1 - 0.637)) ** 0.5, abs=0.03)
