"""A classifier fitted without labels: the labels that it gives itself."""

import pytest
import torch
from hypothesis import given, strategies as st

from robogauntlet_mergevla.routing import self_training
from robogauntlet_mergevla.routing.contract import RoutingError
from robogauntlet_mergevla.routing.features import FeatureSpec
from robogauntlet_mergevla.routing.self_training import fit_self_trained, self_labels, standardised
from tests.mergevla.routing.synthetic import EXPERTS, gaussians, observations

SPEC = FeatureSpec()


def evidence(labels, right, classes=4):
    """One for the true class of a share of the rows, for another class in the others."""
    generator = torch.Generator().manual_seed(0)
    wrong = torch.rand(len(labels), generator=generator) > right
    shift = torch.randint(1, classes, (len(labels),), generator=generator)
    return torch.nn.functional.one_hot((labels + wrong * shift) % classes, classes).float()


def test_weak_evidence_becomes_the_true_classes():
    data = gaussians(0)
    truth = torch.tensor(["abcd".index(label) for label in data.labels])
    first = evidence(truth, right=0.65)
    assert first.argmax(dim=1).eq(truth).float().mean() < 0.75
    assert self_labels(first, data.features, SPEC).eq(truth).float().mean() > 0.98


def test_every_expert_has_an_observation():
    labels = self_labels(torch.tensor([[1.0, 0.0, 0.0]] * 12), torch.randn(12, 5), SPEC)
    assert set(labels.tolist()) == {0, 1, 2}


@given(seed=st.integers(0, 1000), scale=st.floats(0.1, 10), shift=st.floats(-5, 5))
def test_evidence_does_not_depend_on_an_experts_scale(seed, scale, shift):
    columns = torch.randn(20, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    changed = columns * torch.tensor([1.0, scale, 1.0]) + torch.tensor([0.0, 0.0, shift])
    assert torch.allclose(standardised(columns), standardised(changed))
    assert torch.allclose(standardised(columns).mean(dim=0), torch.zeros(3, dtype=torch.float64), atol=1e-9)


def test_an_expert_that_tells_nothing_is_neutral():
    assert standardised(torch.ones(4, 2)).eq(0).all()


def test_the_tasks_of_the_observations_are_not_read(model):
    from dataclasses import replace

    batch, held_out = observations(24), observations(30)[24:]
    hidden = [[replace(one, task=EXPERTS[0]) for one in part] for part in (batch, held_out)]
    (one,), (other,) = (fit_self_trained(model, *parts, [SPEC]) for parts in ((batch, held_out), hidden))
    for name, tensor in one.as_tensors().items():
        assert torch.equal(tensor, other.as_tensors()[name])
    assert one.experts == tuple(sorted(EXPERTS))


def test_fewer_observations_than_experts_are_refused(model):
    with pytest.raises(RoutingError, match="expected 3 first observations or more, got 2"):
        fit_self_trained(model, observations(2), observations(1), [SPEC])


@pytest.mark.parametrize(("agreed", "asked"), [(-0.06, 0), (-0.21, 1)])
def test_stability_is_asked_where_the_base_has_not_learned_the_tasks(model, monkeypatch, agreed, asked):
    calls = []

    def stable(model, batch):
        calls.append(len(batch))
        return torch.rand(len(batch), len(EXPERTS), generator=torch.Generator().manual_seed(0)) - 1

    monkeypatch.setattr(self_training, "agreement", lambda model, batch: torch.full((len(batch), len(EXPERTS)), agreed))
    monkeypatch.setattr(self_training, "stability", stable)
    fit_self_trained(model, observations(12), observations(18)[12:], [SPEC])
    assert calls == [12] * asked
