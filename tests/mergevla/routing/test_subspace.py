"""The paper's routers compared with a naive implementation of its formulae."""

import numpy as np
import pytest
import torch
from hypothesis import given, strategies as st

from robogauntlet_mergevla.routing.subspace import (
    PaperCodedRouter,
    PaperWrittenRouter,
    SubspaceOptions,
    energy,
    hidden_index,
    leading_right_vectors,
)
from tests.mergevla.routing.synthetic import EXPERTS, SmallMergedModel, observations, values


def naive_energy(tokens, weight, rank=8):
    basis = np.linalg.svd(weight.detach().numpy().astype(np.float64))[2][:rank]
    return np.mean([np.sqrt(sum((row @ token) ** 2 for row in basis)) for token in tokens.detach().numpy()])


def hidden(model, expert, one):
    return model.hidden_states(expert, one.images[None], [one.instruction])


@pytest.mark.parametrize(("kept_blocks", "layer"), [(1, 2), (0, 2)])
def test_the_coded_router_projects_the_same_states_one_layer_on(kept_blocks, layer):
    model, batch = SmallMergedModel(kept_blocks=kept_blocks), observations(3)
    for one, routed in zip(batch, PaperCodedRouter().route(batch, model), strict=True):
        for expert in EXPERTS:
            states = hidden(model, expert, one)
            adapter, task = model.own_value_weights(expert)
            expected = (naive_energy(states.action[layer][0], adapter) + naive_energy(states.task[layer][0], task)) / 2
            assert routed.scores[expert] == pytest.approx(expected, rel=1e-5)
        assert routed.choice == max(routed.scores, key=routed.scores.get)
        assert (routed.unknown, routed.rejected) == (None, None)


def test_the_written_router_crosses_the_pairs_at_the_last_layer():
    model, batch = SmallMergedModel(), observations(3)
    for one, routed in zip(batch, PaperWrittenRouter().route(batch, model), strict=True):
        for expert in EXPERTS:
            states = hidden(model, expert, one)
            adapter, task = values(model.models[expert].action_expert.blocks[-1])
            expected = (naive_energy(states.action[-1][0], task) + naive_energy(states.task[-1][0], adapter)) / 2
            assert routed.scores[expert] == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("kind", ["k", "v", "kv"])
@pytest.mark.parametrize("block", [0, 1])
def test_options_choose_projections_rank_and_block(kind, block):
    model, batch = SmallMergedModel(), observations(3)
    chosen = PaperWrittenRouter(SubspaceOptions(kind, rank=3, block=block))
    for one, routed in zip(batch, chosen.route(batch, model), strict=True):
        for expert in EXPERTS:
            states, layer = hidden(model, expert, one), model.models[expert].action_expert.blocks[block]
            expected = np.mean(
                [
                    naive_energy(states.action[block + 1][0], getattr(layer, f"{name}_task").weight, 3) / 2
                    + naive_energy(states.task[block + 1][0], getattr(layer, f"{name}_adapter").weight, 3) / 2
                    for name in kind
                ]
            )
            # Singular values that are nearly alike turn their vectors by more than single precision's 1e-7.
            assert routed.scores[expert] == pytest.approx(expected, rel=1e-4)


def test_the_energy_of_a_case_by_hand():
    """Of diag(3, 2, 1) the first right singular vectors are the first axes: |1| and |(1, -2)| of the one token."""
    weight, token = torch.diag(torch.tensor([3.0, 2.0, 1.0])), torch.tensor([[[1.0, -2.0, 2.0]]])
    lengths = [energy(token, leading_right_vectors(weight, rank)).item() for rank in (1, 2, 3)]
    assert lengths == pytest.approx([1.0, 5.0**0.5, 3.0])


@given(seed=st.integers(0, 1000), rank=st.integers(1, 7))
def test_more_directions_have_more_energy_and_all_have_the_whole(seed, rank):
    generator = torch.Generator().manual_seed(seed)
    weight, states = torch.randn(8, 8, generator=generator), torch.randn(2, 5, 8, generator=generator)
    some, more, all_ = (energy(states, leading_right_vectors(weight, r)) for r in (rank, rank + 1, 8))
    assert (some <= more + 1e-5).all()
    assert torch.allclose(all_, states.norm(dim=-1).mean(dim=-1), atol=1e-4)


@pytest.mark.parametrize(("layers", "kept", "index"), [(24, 1, 24), (24, 2, 23), (24, 3, 22), (24, 0, 24), (4, 3, 2)])
def test_the_coded_router_reads_block_index_plus_two(layers, kept, index):
    assert hidden_index(layers, kept) == index


@pytest.mark.parametrize("kind", [PaperCodedRouter, PaperWrittenRouter])
def test_subspaces_are_computed_once_per_model(kind):
    router, one, other = kind(), SmallMergedModel(), SmallMergedModel(EXPERTS[:2])
    for _ in range(2):
        router.route(observations(2), one)
    assert one.factorised == 3
    assert router.route(observations(1), other)[0].scores.keys() == set(EXPERTS[:2])
    assert other.factorised == 2


def test_stored_singular_vectors_give_the_same_scores_as_the_weights():
    generator = torch.Generator().manual_seed(0)
    weight, states = torch.randn(16, 16, generator=generator), torch.randn(2, 5, 16, generator=generator)
    vectors = leading_right_vectors(weight)
    again = leading_right_vectors(vectors)
    assert vectors.shape == (8, 16)
    assert torch.allclose(vectors @ vectors.mT, torch.eye(8), atol=1e-5)
    assert torch.allclose(energy(states, vectors), energy(states, again), atol=1e-5)
