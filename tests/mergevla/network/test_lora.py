"""Adapters: their deltas, and the unchanged weights."""

import pytest
import torch
from torch import nn

from robogauntlet_mergevla.checkpoints.expert_checkpoint import tensors_of
from robogauntlet_mergevla.network.config import LoraSettings
from robogauntlet_mergevla.network.lora import (
    LoraError,
    add_lora,
    factor_shapes,
    folded,
    has_lora,
    lora_factors,
    plain_name,
)
from robogauntlet_mergevla.network.model import assembled
from tests.mergevla.shared import SMALL, inputs, small_model


def adapted(settings=None, seed=3):
    """A model with adapters whose B is not zero any more."""
    model = small_model()
    add_lora(model, settings or LoraSettings(rank=2), seed)
    torch.manual_seed(0)
    with torch.no_grad():
        for module in model.modules():
            if hasattr(module, "lora_B"):
                module.lora_B["default"].weight.normal_(std=0.1)
    return model


def factors_of(model):
    return lora_factors(tensors_of(model), LoraSettings(2))


def test_new_adapters_change_nothing_and_depend_on_their_seed_alone():
    plain, one, two = small_model(), small_model(), small_model()
    add_lora(one, LoraSettings(rank=2), seed=1)
    torch.manual_seed(99)
    add_lora(two, LoraSettings(rank=2), seed=1)
    batch = inputs(SMALL)
    assert torch.equal(one(*batch), plain(*batch))
    for a, b in zip(factors_of(one).values(), factors_of(two).values(), strict=True):
        assert torch.equal(a.a, b.a)
        assert a.a.std() > 0


@pytest.mark.parametrize("convolutions", [False, True])
def test_every_linear_layer_of_the_backbone_and_nothing_else_is_adapted(convolutions):
    kinds = (nn.Linear, nn.Conv2d) if convolutions else nn.Linear
    names = {f"backbone.{n}.weight" for n, m in small_model().backbone.named_modules() if isinstance(m, kinds)}
    assert set(factors_of(adapted(LoraSettings(2, convolutions)))) == names


@pytest.mark.parametrize("convolutions", [False, True])
def test_the_shapes_of_factors_are_known_without_them(convolutions):
    settings = LoraSettings(2, convolutions)
    factors = {name: t.shape for name, t in tensors_of(adapted(settings)).items() if ".lora_" in name}
    assert factor_shapes(small_model(), settings) == factors


def test_the_base_is_frozen_and_all_else_trains():
    trained = {plain_name(name) for name, weight in adapted().named_parameters() if weight.requires_grad}
    assert {name.rpartition(".")[2] for name in trained if name.startswith("backbone.")} == {"lora_A", "lora_B"}
    others = {name for name, _ in small_model().named_parameters() if not name.startswith("backbone.")}
    assert others == {name for name in trained if not name.startswith("backbone.")}


@pytest.mark.parametrize("convolutions", [False, True])
def test_deltas_are_fp32_and_equal_to_pefts(convolutions):
    model = adapted(LoraSettings(2, convolutions))
    deltas = {name: factors.delta() for name, factors in factors_of(model).items()}
    for name, module in model.backbone.named_modules():
        if hasattr(module, "lora_B"):
            delta = deltas.pop(f"backbone.{name}.weight")
            assert delta.dtype == torch.float32
            torch.testing.assert_close(delta, module.get_delta_weight("default"))
    assert not deltas


@pytest.mark.parametrize("convolutions", [False, True])
def test_a_folded_model_has_no_adapters_and_acts_the_same(convolutions):
    model = adapted(LoraSettings(2, convolutions))
    plain = assembled(SMALL, folded(tensors_of(model), LoraSettings(2, convolutions)))
    batch = inputs(SMALL)
    assert not has_lora(plain)
    assert not torch.allclose(model(*batch), small_model()(*batch), atol=1e-4)
    torch.testing.assert_close(plain(*batch), model(*batch), atol=1e-5, rtol=0)


def test_second_adapters_and_ranks_above_the_width_are_refused():
    with pytest.raises(LoraError, match="fold it first"):
        add_lora(adapted(), LoraSettings(rank=2), 0)
    with pytest.raises(LoraError, match="rank of 1 to 16, got 17"):
        add_lora(small_model(), LoraSettings(rank=17), 0)
