"""Task vectors from weights and from LoRA factors, and the hash of a base."""

import pytest
import torch

from policies.mergevla.merging.errors import ExpertsDiffer
from policies.mergevla.merging.taus import rms, task_vector, weights_hash


def test_a_task_vector_is_what_fine_tuning_added():
    tau = task_vector({"w": torch.tensor([3.0, 1.0])}, {"w": torch.tensor([1.0, 1.0])})
    assert tau["w"].tolist() == [2, 0]


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


def test_the_hash_of_weights_changes_with_values_names_shapes_and_types_only():
    weights = {"w": torch.tensor([[1.0, 2.0]]), "gate": torch.tensor(0.5)}
    reference = weights_hash(weights)
    assert weights_hash(dict(reversed(weights.items()))) == reference
    assert weights_hash({**weights, "w": weights["w"].T.contiguous().T}) == reference
    for changed in (
        {**weights, "gate": torch.tensor(0.25)},
        {"v": weights["w"], "gate": weights["gate"]},
        {**weights, "w": weights["w"].T},
        {**weights, "gate": weights["gate"].double()},
    ):
        assert weights_hash(changed) != reference


def test_root_mean_square():
    assert rms({"a": torch.tensor([3.0]), "b": torch.tensor([4.0, 0.0, 0.0])}) == pytest.approx(2.5)
    assert rms({}) == 0.0
