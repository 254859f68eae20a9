"""Merging and masking in one call."""

import pytest
import torch

from policies.mergevla.merging.elementwise import emr, emr_modulators
from policies.mergevla.merging.errors import ExpertsDiffer, OutOfRange
from policies.mergevla.merging.masks import masked, task_masks
from policies.mergevla.merging.merged import merge
from policies.mergevla.merging.operators import OPERATORS
from policies.mergevla.merging.recipe import MaskRule
from tests.policies.mergevla.merging.strategies import close, copied, equal, random_taus


@pytest.mark.parametrize("operator", OPERATORS)
@pytest.mark.parametrize("rule", MaskRule)
def test_every_operator_goes_with_every_mask_rule(operator, rule):
    experts = random_taus(3)
    before = copied(experts)
    merged = merge(experts, operator, rule=rule)
    for expert in experts:
        read = merged.of(expert)
        assert read.keys() == experts[expert].keys()
        assert all(torch.isfinite(delta).all() for delta in read.values())
    assert all(equal(before[expert], experts[expert]) for expert in experts)


def test_without_masks_all_tasks_read_the_same():
    merged = merge(random_taus(3), rule=MaskRule.NONE)
    assert equal(merged.of("expert0"), merged.of("expert2"))
    assert not merged.masks
    assert not merged.lambdas


def test_task_masks_choose_from_the_merged_vector():
    experts = random_taus(3)
    merged = merge(experts, "ties", lambdas=0.4)
    mask = task_masks(experts, merged.tau, 0.4)["expert1"]
    assert equal(merged.of("expert1"), masked(merged.tau, mask))
    assert merged.lambdas == dict.fromkeys(experts, 0.4)


def test_emr_reads_through_masks_and_rescalers_whatever_alpha_is():
    experts = random_taus(3)
    unified = emr(experts)
    modulator = emr_modulators(experts, unified)["expert1"]
    expected = {name: delta * modulator.mask[name] * modulator.rescaler for name, delta in unified.items()}
    assert close(merge(experts, "emr", rule=MaskRule.EMR).of("expert1"), expected)
    assert close(merge(experts, "emr", rule=MaskRule.EMR, alpha=0.3).of("expert1"), expected)


def test_weights_are_the_base_plus_what_the_task_reads():
    experts = random_taus(2)
    merged = merge(experts)
    base = {"w": torch.ones(6, 8), "b": torch.ones(6), "norm": torch.ones(2)}
    weights = merged.weights(base, "expert0")
    assert torch.equal(weights["w"], base["w"] + merged.of("expert0")["w"])
    assert torch.equal(weights["norm"], base["norm"])


def test_an_expert_that_was_not_merged_is_refused():
    with pytest.raises(ExpertsDiffer, match="expected one of the merged experts expert0, got stranger"):
        merge(random_taus(1)).of("stranger")


def test_a_lambda_out_of_range_is_refused_before_anything_is_computed():
    with pytest.raises(OutOfRange, match="lambda"):
        merge({"a": {}}, "no such operator", lambdas=3.0)


def test_an_unknown_mask_rule_is_refused():
    with pytest.raises(OutOfRange, match="expected a mask rule out of none, task, emr, signs, got tall"):
        merge(random_taus(1), rule="tall")
