"""Merging and masking in one call."""

import pytest
import torch

from robogauntlet_mergevla.merging.elementwise import emr, emr_modulators
from robogauntlet_mergevla.merging.errors import ExpertsDiffer
from robogauntlet_mergevla.merging.masks import masked, task_masks
from robogauntlet_mergevla.merging.merge import OPERATORS, merge
from robogauntlet_mergevla.merging.recipe import MaskRule, Recipe
from tests.mergevla.merging.strategies import close, copied, equal, random_task_vectors


@pytest.mark.parametrize("operator", OPERATORS)
@pytest.mark.parametrize("rule", MaskRule)
def test_every_operator_works_with_every_mask_rule(operator, rule):
    experts = random_task_vectors(3)
    before = copied(experts)
    merged = merge(experts, Recipe(operator, masks=rule))
    for expert in experts:
        deltas = merged.of(expert)
        assert deltas.keys() == experts[expert].keys()
        assert all(torch.isfinite(delta).all() for delta in deltas.values())
    assert all(equal(before[expert], experts[expert]) for expert in experts)


def test_without_masks_all_tasks_have_the_same_delta():
    merged = merge(random_task_vectors(3), Recipe("ta", masks=MaskRule.NONE))
    assert equal(merged.of("expert0"), merged.of("expert2"))
    assert not merged.masks


def test_task_masks_choose_from_the_merged_vector():
    experts = random_task_vectors(3)
    merged = merge(experts, Recipe("ties", lambda_=0.4))
    mask = task_masks(experts, merged.vector, 0.4)["expert1"]
    assert equal(merged.of("expert1"), masked(merged.vector, mask))


def test_emr_applies_masks_and_rescalers_for_any_alpha():
    experts = random_task_vectors(3)
    unified = emr(experts)
    masks, rescalers = emr_modulators(experts, unified)
    expected = {name: delta * masks["expert1"][name] * rescalers["expert1"] for name, delta in unified.items()}
    assert close(merge(experts, Recipe("emr", masks=MaskRule.EMR)).of("expert1"), expected)
    assert close(merge(experts, Recipe("emr", masks=MaskRule.EMR, alpha=0.3)).of("expert1"), expected)


def test_an_expert_that_was_not_merged_is_refused():
    with pytest.raises(ExpertsDiffer, match="expected one of the merged experts expert0, got unknown"):
        merge(random_task_vectors(1), Recipe("ta")).of("unknown")
