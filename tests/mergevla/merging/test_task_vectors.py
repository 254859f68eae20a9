"""Task vectors from weights."""

import pytest
import torch

from robogauntlet_mergevla.merging.errors import DifferentBases, ExpertsDiffer
from robogauntlet_mergevla.merging.task_vectors import check_same_base, rms, task_vector


def test_a_task_vector_is_the_difference_from_the_base():
    vector = task_vector({"w": torch.tensor([3.0, 1.0])}, {"w": torch.tensor([1.0, 1.0])})
    assert vector["w"].tolist() == [2, 0]


def test_a_task_vector_of_other_weights_is_refused():
    with pytest.raises(ExpertsDiffer, match="weight w is missing"):
        task_vector({}, {"w": torch.zeros(1)})


def test_folding_into_bf16_loses_small_deltas():
    generator = torch.Generator().manual_seed(0)
    a, b = torch.randn(2, 50, generator=generator), torch.randn(40, 2, generator=generator)
    base = {"w": (torch.randn(40, 50, generator=generator) * 0.03).bfloat16()}
    delta = b @ a * 1e-5
    folded = task_vector({"w": (base["w"].float() + delta).bfloat16()}, base)["w"]
    assert (folded == 0).float().mean() > 0.3
    assert (delta == 0).float().mean() < 0.01


def test_experts_of_different_bases_are_refused():
    check_same_base({"a": "0f", "b": "0f"})
    with pytest.raises(DifferentBases, match="expected all experts from base 0f of a, got 1e for b"):
        check_same_base({"a": "0f", "b": "1e"})


def test_root_mean_square():
    assert rms({"a": torch.tensor([3.0]), "b": torch.tensor([4.0, 0.0, 0.0])}) == pytest.approx(2.5)
    assert rms({}) == 0.0
