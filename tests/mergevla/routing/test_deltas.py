"""What experts' deltas say about an observation: projection algebra, and the router that needs no label."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from robogauntlet_mergevla.network.model import build
from robogauntlet_mergevla.network.tokenizer import tokenizer_for
from robogauntlet_mergevla.routing.contract import RoutingError
from robogauntlet_mergevla.routing.deltas import DeltaEnergyRouter, agreement, directions, energies, stability
from tests.mergevla.network.test_pretrained import LITTLE
from tests.mergevla.routing.synthetic import EXPERTS, SmallMergedModel, observations


def test_rows_have_norm_one_or_are_orthonormal(model):
    assert directions(model).keys() == directions(model, 3).keys()
    for whole in directions(model).values():
        assert torch.allclose(whole.flatten(1).norm(dim=1), torch.ones(len(EXPERTS)))
    for rows in directions(model, 3).values():
        assert torch.allclose(rows @ rows.mT, torch.eye(3).expand(len(EXPERTS), 3, 3), atol=1e-5)


def test_row_spaces_have_at_most_a_quarter_of_the_inputs(model):
    assert all(rows.shape[1] == rows.shape[2] // 4 for rows in directions(model, 99).values())


def test_energies_are_those_of_a_naive_computation(model):
    rows, batch = directions(model), observations(2)
    found = energies(model, rows, batch, sees_instruction=True)
    assert found.shape == (2, len(rows), len(EXPERTS))
    inputs = []
    layer = model.models[None].backbone.projector[0]
    hook = layer.register_forward_pre_hook(lambda module, arguments: inputs.append(arguments[0]))
    model.hidden_states(None, torch.stack([one.images for one in batch]), [one.instruction for one in batch])
    hook.remove()
    place = list(rows).index("projector.0")
    for i, tokens in enumerate(inputs[0].detach().numpy()):
        for j, expert in enumerate(EXPERTS):
            delta = (model.models[expert].backbone.projector[0].weight - layer.weight).detach().numpy()
            shares = [
                np.square(delta @ token).sum() / np.square(delta).sum() / np.square(token).sum() for token in tokens
            ]
            assert found[i, place, j].item() == pytest.approx(np.log(np.mean(shares)), abs=1e-4)


def test_the_expert_whose_delta_acts_least_is_chosen(model):
    batch = observations(3)
    found = energies(model, directions(model), batch, sees_instruction=True).sum(dim=1)
    routed = DeltaEnergyRouter().route(batch, model)
    assert [one.choice for one in routed] == [EXPERTS[i] for i in found.argmin(dim=1)]
    assert all(one.unknown is None for one in routed)


def test_towers_that_see_each_camera_by_itself_count_once_for_an_observation():
    architecture = replace(LITTLE, cameras=("third_person", "wrist"))
    model = SmallMergedModel()
    model.architecture = architecture
    model.models = {name: build(architecture, seed).eval() for seed, name in enumerate((None, *EXPERTS))}
    model.hidden_states = lambda expert, images, texts: model.models[expert].hidden_states(
        images, tokenizer_for(architecture)(texts)
    )
    size = architecture.image_size
    batch = [replace(one, images=torch.rand(2, 3, size, size)) for one in observations(2)]
    together = energies(model, directions(model), batch, sees_instruction=True)
    alone = torch.cat([energies(model, directions(model), [one], sees_instruction=True) for one in batch])
    assert torch.allclose(together, alone, atol=1e-4)


def test_no_hook_stays_in_the_base(model):
    energies(model, directions(model), observations(1), sees_instruction=False)
    assert not any(module._forward_pre_hooks for module in model.models[None].modules())


def test_experts_equal_to_the_base_are_refused():
    same = SmallMergedModel()
    same.models = dict.fromkeys(same.models, same.models[None])
    with pytest.raises(RoutingError, match="expected experts that differ from the base in a layer"):
        DeltaEnergyRouter().route(observations(1), same)


def test_layers_that_an_expert_leaves_as_they_are_are_left_out_or_say_nothing():
    some = SmallMergedModel()
    some.models[EXPERTS[0]] = some.models[None]
    found = energies(some, directions(some, 2), observations(2), sees_instruction=True)
    assert torch.isfinite(found).all()
    assert (found[..., 0] == found[0, 0, 0]).all()


def test_agreement_is_full_for_an_expert_that_is_the_base_and_never_positive():
    some = SmallMergedModel()
    some.models[EXPERTS[1]] = some.models[None]
    found = agreement(some, observations(4))
    assert found.shape == (4, len(EXPERTS))
    assert (found[:, 1] == 0).all()
    assert ((found >= -1) & (found <= 0)).all()
    assert (found[:, 0] < 0).all()


def test_stability_depends_on_the_episode_alone_and_is_never_positive(model):
    batch = observations(4)
    found = stability(model, batch)
    assert found.shape == (4, len(EXPERTS))
    assert ((found >= -1) & (found < 0)).all()
    assert torch.allclose(found[1:2], stability(model, batch[1:2]), atol=1e-6)
    other = [replace(one, episode_id=f"{one.episode_id}-other") for one in batch]
    assert not torch.allclose(found, stability(model, other))
