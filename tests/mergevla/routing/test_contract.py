"""Properties of every router."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from robogauntlet_mergevla.routing.catalog import NAMES, router
from robogauntlet_mergevla.routing.contract import RoutingError, answer
from tests.mergevla.routing.synthetic import EXPERTS, SmallMergedModel, observation, observations

PASSES = {
    **{"paper-coded": 3, "paper-written": 3},
    **{"calibrated": 1, "nearest-centroid": 1, "self-trained": 1, "delta-energy": 1},
}


def close(a, b):
    same = a.choice == b.choice and a.rejected == b.rejected and a.scores.keys() == b.scores.keys()
    near = all(a.scores[e] == pytest.approx(b.scores[e], rel=1e-5, abs=1e-5) for e in a.scores)
    return same and near and (a.unknown == b.unknown or a.unknown == pytest.approx(b.unknown, rel=1e-5, abs=1e-5))


@pytest.mark.parametrize("sees_instruction", [True, False])
@pytest.mark.parametrize("name", NAMES)
def test_an_answer_depends_on_its_own_first_observation_alone(name, sees_instruction, model, stored):
    chosen = router(name, sees_instruction=sees_instruction, stored=stored)
    batch = observations()
    together = chosen.route(batch, model)
    assert [answer.scores.keys() for answer in together] == [set(EXPERTS)] * len(batch)
    assert all(close(chosen.route([one], model)[0], a) for one, a in zip(batch, together, strict=True))
    backwards = chosen.route(batch[::-1], model)[::-1]
    assert all(map(close, together, backwards))


@pytest.mark.parametrize("name", NAMES)
def test_the_order_of_the_experts_changes_nothing(name, model, stored):
    chosen, batch = router(name, stored=stored), observations()
    reordered = SmallMergedModel(EXPERTS[::-1])
    assert all(map(close, chosen.route(batch, model), chosen.route(batch, reordered)))


@pytest.mark.parametrize("name", ["paper-coded", "paper-written"])
def test_scores_of_an_expert_do_not_depend_on_the_others(name, model):
    batch = observations(3)
    fewer = SmallMergedModel(EXPERTS[1:])
    all_of_them, some = (router(name).route(batch, c) for c in (model, fewer))
    for a, b in zip(all_of_them, some, strict=True):
        assert all(a.scores[e] == pytest.approx(b.scores[e], abs=1e-6) for e in fewer.experts)


@pytest.mark.parametrize("name", NAMES)
def test_a_decision_takes_the_declared_number_of_passes(name, stored):
    model = SmallMergedModel()
    chosen = router(name, stored=stored)
    chosen.route(observations(2), model)
    assert len(model.passes) == chosen.passes(3) == PASSES.get(name, 0)
    assert chosen.passes(9) == {3: 9, 1: 1, 0: 0}[chosen.passes(3)]


@pytest.mark.parametrize("name", NAMES)
def test_a_hidden_instruction_has_no_effect(name, model, stored):
    pair = [observation(0, EXPERTS[0], words) for words in ("push the cube", "open the door")]
    hidden = router(name, sees_instruction=False, stored=stored)
    assert not hidden.sees_instruction
    assert close(*hidden.route(pair, model))


@pytest.mark.parametrize("name", NAMES)
def test_nothing_to_route_is_no_error(name, model, stored):
    assert router(name, stored=stored).route([], model) == []


def test_of_equal_scores_the_first_name_is_chosen():
    assert answer({"b": 1.0, "a": 1.0, "c": 0.0}).choice == "a"
    assert answer({"a": 1.0}, unknown=2.0).rejected is None
    assert [answer({"a": 1.0}, 2.0, threshold).rejected for threshold in (1.0, 2.0)] == [True, False]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"images": torch.zeros(3, 16, 16)},
            r"expected images of shape \(cameras, 3, H, W\) in \[0, 1\], got \(3, 16,",
        ),
        ({"images": torch.zeros(2, 3, 16, 16, dtype=torch.uint8)}, "got .* of torch.uint8"),
        ({"proprioception": np.zeros(7)}, r"expected proprioception of shape \(8 \* arms,\), got \(7,\)"),
    ],
)
def test_a_first_observation_of_another_shape_is_refused(change, message):
    with pytest.raises(RoutingError, match=message):
        replace(observation(0), **change)


@pytest.mark.parametrize("name", PASSES)
def test_images_of_another_size_are_refused(name, model, stored):
    large = replace(observation(0), images=torch.zeros(2, 3, 32, 32))
    with pytest.raises(RoutingError, match=r"expected images of shape \(2, 3, 16, 16\), got \(2, 3, 32, 32\)"):
        router(name, stored=stored).route([large], model)
