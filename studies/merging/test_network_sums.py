"""Sums of networks, on tensors of a few numbers."""

import torch

from studies.merging.network_sums import added, interpolated

BASE = {
    "backbone.vision.w": torch.zeros(3),
    "backbone.language.layers.0.w": torch.zeros(3),
    "action_queries": torch.zeros(3),
}
EXPERT = {name: torch.full((3,), 2.0) for name in BASE}


def test_an_interpolation_ends_at_the_base_and_at_the_expert():
    for share, value in ((0.0, 0.0), (0.25, 0.5), (1.0, 2.0)):
        assert {float(weight.mean()) for weight in interpolated(BASE, EXPERT, share).values()} == {value}


def test_parts_that_are_not_interpolated_are_the_experts():
    found = interpolated(BASE, EXPERT, 0.5, ("vision", "projector"))
    assert {name: float(weight.mean()) for name, weight in found.items()} == {
        "backbone.vision.w": 1.0,
        "backbone.language.layers.0.w": 2.0,
        "action_queries": 2.0,
    }


def test_a_sum_has_its_shares():
    assert {float(weight.mean()) for weight in added([BASE, EXPERT], [0.75, 0.25]).values()} == {0.5}
