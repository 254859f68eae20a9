"""Rates against chance, distances, bytes and the report."""

import json
import math
from dataclasses import FrozenInstanceError

import pytest
import torch

from robogauntlet_mergevla.merging.diagnostics import (
    block_distances,
    bytes_per_task,
    cosine,
    gaussian_null,
    keep_rate,
    mask_statistics,
    permutation_null,
    report,
    selfish_rate,
)
from robogauntlet_mergevla.merging.errors import ExpertsDiffer
from robogauntlet_mergevla.merging.merge import merge
from robogauntlet_mergevla.merging.recipe import MaskRule, Recipe
from tests.mergevla.merging.strategies import random_task_vectors


def bits(*entries):
    return {"w": torch.tensor(entries, dtype=torch.bool)}


def generator():
    return torch.Generator().manual_seed(0)


@pytest.mark.parametrize(
    ("operator", "experts", "keep", "selfish", "cos"),
    [
        ("ta", 2, 0.66, 0.69, 0.82),
        ("ta", 4, 0.49, 0.34, 0.70),
        ("ta", 8, 0.36, 0.18, 0.60),
        ("ta", 16, 0.26, 0.14, 0.52),
        ("ties", 2, 0.58, 0.84, 0.90),
        ("ties", 4, 0.30, 0.73, 0.78),
        ("ties", 8, 0.08, 0.51, 0.52),
        ("ties", 16, 0.00, 0.04, 0.14),
    ],
)
def test_the_null_has_known_values_for_independent_gaussian_experts(operator, experts, keep, selfish, cos):
    """Known values to two digits, lambda 0.6; their own rounding is 0.005, the simulation's error about 0.002."""
    scales = {f"e{i}": 1.0 for i in range(experts)}
    null = gaussian_null(scales, Recipe(operator), generator=generator(), shape=(500, 500))
    assert sum(null.keep.values()) / experts == pytest.approx(keep, abs=0.008)
    assert null.selfish == pytest.approx(selfish, abs=0.008)
    assert sum(null.cosine.values()) / experts == pytest.approx(cos, abs=0.008)


def test_the_mean_instead_of_the_sum_removes_the_masks_selectivity():
    null = gaussian_null({f"e{i}": 1.0 for i in range(4)}, Recipe("mean"), generator=generator())
    assert null.keep["e0"] > 0.7


def test_the_null_repeats_for_equal_generators_and_depends_on_relative_scales_alone():
    scales = {"a": 1.0, "b": 3.0}
    null = gaussian_null(scales, Recipe("ta"), generator=generator())
    assert null == gaussian_null(scales, Recipe("ta"), generator=generator())
    assert null.keep == gaussian_null({"a": 0.25, "b": 0.75}, Recipe("ta"), generator=generator()).keep
    assert null.keep["a"] < null.keep["b"] - 0.2


def test_keep_and_selfish_rate_have_known_values():
    masks = [bits(1, 1, 0, 0), bits(1, 0, 0, 0), bits(1, 0, 1, 0)]
    assert [keep_rate(mask) for mask in masks] == [0.5, 0.25, 0.5]
    assert selfish_rate(masks) == 0.5
    assert keep_rate({}) == selfish_rate([{}]) == 0.0


def test_the_cosine_has_known_values():
    a, b = {"w": torch.tensor([3.0]), "v": torch.tensor([4.0])}, {"w": torch.tensor([1.0]), "v": torch.tensor([0.0])}
    assert cosine(a, b) == pytest.approx(0.6)
    assert cosine(a, a) == pytest.approx(1.0)
    assert cosine(a, {"w": torch.zeros(1), "v": torch.zeros(1)}) == 0.0


def test_independent_experts_are_as_selfish_as_the_null():
    experts = random_task_vectors(4, shape=(300, 300))
    observed = mask_statistics(experts, merge(experts, Recipe("ties")))
    assert observed.selfish == pytest.approx(0.727, abs=0.01)


def test_without_masks_everything_is_kept_by_all():
    experts = random_task_vectors(3)
    statistics = mask_statistics(experts, merge(experts, Recipe("ta", masks=MaskRule.NONE)))
    assert set(statistics.keep.values()) == {1.0}
    assert statistics.selfish == 0.0


def test_statistics_of_other_experts_are_refused():
    with pytest.raises(ExpertsDiffer, match="expected the merged experts expert0, expert1, got expert0"):
        mask_statistics(random_task_vectors(1), merge(random_task_vectors(2), Recipe("ta")))


def test_block_distances_have_known_values():
    names = ("action_expert.blocks.0.w", "action_expert.blocks.1.w", "out")
    weights = {"a": ([3.0, 0.0], [1.0], [9.0]), "b": ([0.0, 3.0], [1.0], [1.0]), "c": ([3.0, 0.0], [-1.0], [0.0])}
    experts = {expert: dict(zip(names, map(torch.tensor, own), strict=True)) for expert, own in weights.items()}
    # Block 0: two unrelated pairs and an equal one; block 1: an equal pair and two opposite ones.
    expected = (2 * math.sqrt(2) / 3, 4 / 3)
    assert block_distances(experts) == pytest.approx(expected)
    assert block_distances({"a": experts["a"]}) == (0.0, 0.0)


def test_bytes_per_task_have_known_values():
    vector = {"w": torch.zeros(3, 5), "gate": torch.zeros(())}
    head = {"out": torch.zeros(7), "norm": torch.zeros(2, dtype=torch.bfloat16)}
    costs = bytes_per_task(vector, head, lora_rank=4)
    assert (costs.mask, costs.head, costs.lora) == (2 + 1, 28 + 4, 4 * 4 * 8)
    assert bytes_per_task(vector, head, masks=0).mask == 0
    assert bytes_per_task(vector, head).lora is None


@pytest.mark.parametrize("rule", MaskRule)
def test_a_report_is_frozen_and_json_holds_all_of_it(rule):
    experts = random_task_vectors(3)
    heads = {expert: {"out": torch.zeros(2)} for expert in experts}
    weights = {
        expert: {"action_expert.blocks.0.w": vector["w"], "action_expert.blocks.1.w": vector["b"]}
        for expert, vector in experts.items()
    }
    merged = merge(experts, Recipe("ties", masks=rule, options={"trim": 0.1}))
    made = report(experts, merged, generator=generator(), heads=heads, lora_rank=2, weights=weights)
    with pytest.raises(FrozenInstanceError):
        made.entries = 0  # type: ignore[misc]
    read = json.loads(made.to_json())
    assert read["entries"] == 6 * 8 + 6
    assert read["observed"]["keep"].keys() == read["null"]["cosine"].keys() == experts.keys()
    assert read["bytes_per_task"]["expert0"]["head"] == 8
    assert len(read["block_distances"]["action_expert"]) == 2


def test_chance_is_that_of_the_merge_reported_on():
    experts, recipe = random_task_vectors(3), Recipe("ta", alpha=0.5, lambda_=0.3)
    made = report(experts, merge(experts, recipe), generator=generator())
    drawn = generator()
    assert made.null == permutation_null(experts, recipe, generator=drawn)
    assert made.gaussian == gaussian_null(made.scales, recipe, generator=drawn)
    assert made.null != permutation_null(experts, Recipe("ta", lambda_=0.3), generator=generator())


def test_entries_in_another_order_are_unrelated_and_keep_the_scales_of_their_weights():
    # Two equal experts, whose first weight is a hundred times the second.
    one = {"w": 100 * torch.randn(100, 100, generator=generator()), "v": torch.randn(100, 100, generator=generator())}
    experts = {"a": one, "b": dict(one)}
    assert mask_statistics(experts, merge(experts, Recipe("ta"))).keep["a"] == 1.0
    null = permutation_null(experts, Recipe("ta"), generator=generator())
    unrelated = gaussian_null({"a": 1.0, "b": 1.0}, Recipe("ta"), generator=generator())
    assert null.keep["a"] == pytest.approx(unrelated.keep["a"], abs=0.01)
    assert null.cosine["a"] == pytest.approx(unrelated.cosine["a"], abs=0.01)


def test_a_report_on_experts_that_changed_nothing_holds_no_nan():
    experts = {expert: {"w": torch.zeros(2, 2)} for expert in "ab"}
    made = report(experts, merge(experts, Recipe("ties")), generator=generator())
    assert made.observed.keep == {"a": 0.0, "b": 0.0}
    assert "NaN" not in made.to_json()
