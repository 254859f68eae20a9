"""The routers of this study are found by their names, and keep what every router promises."""

import numpy as np
import pytest
import torch

from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
from robogauntlet_mergevla.routing.catalog import fit_routers, router
from robogauntlet_mergevla.routing.contract import FirstObservation, RoutingError
from studies.routing.deltas import agreement
from tests.mergevla import test_experts_of_several_tasks as several
from tests.mergevla.experts import TASKS
from tests.mergevla.routing.synthetic import EXPERTS, SmallMergedModel, frames, observation, observations
from tests.mergevla.routing.test_contract import close
from tests.mergevla.training.test_two_arms import ONE, merged, trained

__all__ = ["merged", "trained"]
NAMES = ("delta-energy", "self-trained")


@pytest.fixture(scope="module")
def stored(model):
    return fit_routers(model, frames(0, 8), frames(50, 6), ["self-trained"])


@pytest.mark.parametrize("sees_instruction", [True, False])
@pytest.mark.parametrize("name", NAMES)
def test_an_answer_depends_on_its_own_first_observation_alone(name, sees_instruction, model, stored):
    chosen, batch = router(name, sees_instruction=sees_instruction, stored=stored), observations()
    together = chosen.route(batch, model)
    assert [answer.scores.keys() for answer in together] == [set(EXPERTS)] * len(batch)
    assert all(close(chosen.route([one], model)[0], a) for one, a in zip(batch, together, strict=True))
    assert chosen.route([], model) == []


@pytest.mark.parametrize("name", NAMES)
def test_the_order_of_the_experts_changes_nothing(name, model, stored):
    chosen, batch = router(name, stored=stored), observations()
    assert all(map(close, chosen.route(batch, model), chosen.route(batch, SmallMergedModel(EXPERTS[::-1]))))


@pytest.mark.parametrize("name", NAMES)
def test_a_decision_takes_one_pass(name, stored):
    model = SmallMergedModel()
    chosen = router(name, stored=stored)
    chosen.route(observations(2), model)
    assert len(model.passes) == chosen.passes(3) == chosen.passes(9) == 1


@pytest.mark.parametrize("name", NAMES)
def test_a_hidden_instruction_has_no_effect(name, model, stored):
    pair = [observation(0, EXPERTS[0], words) for words in ("push the cube", "open the door")]
    assert close(*router(name, sees_instruction=False, stored=stored).route(pair, model))


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
