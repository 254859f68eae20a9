"""The router that is fitted without tasks, and what it is fitted by."""

import numpy as np
import pytest
import torch

from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
from robogauntlet_mergevla.routing.catalog import fit_routers, router
from robogauntlet_mergevla.routing.contract import FirstObservation, RoutingError
from robogauntlet_mergevla.routing.deltas import agreement
from tests.mergevla import test_experts_of_several_tasks as several
from tests.mergevla.experts import TASKS
from tests.mergevla.routing.synthetic import frames
from tests.mergevla.training.test_two_arms import ONE, merged, trained

__all__ = ["merged", "trained"]


def test_too_few_observations_are_refused_by_name(model):
    few = {task: one if number < 2 else [] for number, (task, one) in enumerate(frames(0, 1).items())}
    with pytest.raises(RoutingError, match="first observations or more, got 2"):
        fit_routers(model, few, frames(50, 1), ["self-trained"])


def test_a_router_fitted_without_tasks_has_a_class_for_each_expert(tmp_path):
    base = several.save_base(tmp_path / "base")
    experts = [
        several.save_expert(tmp_path / "experts" / several.NAME, base, several.NAME, 1, several=several.BOTH),
        several.save_expert(tmp_path / "experts" / "raise", base, TASKS[2], 2),
    ]
    model = MergedModel(several.merging(experts).parts)
    fitted = fit_routers(model, several.frames(0, 8), several.frames(8, 4), ["self-trained"])
    routed = router("self-trained", stored=fitted).route([several.observation(20, task) for task in TASKS], model)
    assert all(one.scores.keys() == set(model.experts) for one in routed)


def test_agreement_counts_the_numbers_that_an_expert_has(merged):
    model = MergedModel(merged)
    shown = [FirstObservation(torch.zeros(2, 3, 16, 16), "reach", np.zeros(8 * n), str(n), ONE) for n in (1, 2)]
    before = agreement(model, shown)
    with torch.no_grad():
        model.model(ONE).action_expert.output.bias[7:] += 1.0  # never trained, and not used
    assert torch.equal(agreement(model, shown), before)
