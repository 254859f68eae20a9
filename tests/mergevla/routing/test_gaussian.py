"""Gaussian classes: fitting, probabilities, the unknown, and storage."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings, strategies as st

from robogauntlet_mergevla.routing.contract import RoutingError
from robogauntlet_mergevla.routing.features import FeatureSpec, LabelledFeatures
from robogauntlet_mergevla.routing.fitted_router import conformal_threshold, temperature_of
from robogauntlet_mergevla.routing.gaussian import GaussianRouterFit, fit, ledoit_wolf
from tests.mergevla.routing.synthetic import gaussians

READING = FeatureSpec()


@pytest.fixture(scope="module")
def calibration():
    return fit(gaussians(0), gaussians(1), READING)


def test_separable_classes_are_routed_correctly(calibration):
    new = gaussians(2)
    chosen = [calibration.experts[i] for i in calibration.scores(new.features).argmax(dim=1)]
    assert chosen == list(new.labels)


@settings(max_examples=25)
@given(st.integers(0, 2**16), st.floats(0.1, 100.0))
def test_probabilities_sum_to_one(calibration, seed, scale):
    features = torch.randn(4, 12, generator=torch.Generator().manual_seed(seed)) * scale
    assert torch.allclose(calibration.scores(features).exp().sum(dim=1), torch.ones(4).double())


def test_scores_are_those_of_gaussians_at_the_temperature(calibration):
    features = gaussians(2).features
    warm = replace(calibration, temperature=3.0)
    expected = torch.log_softmax(-(calibration.distances(features) ** 2) / 6.0, dim=1)
    assert torch.allclose(warm.scores(features), expected)


def test_distances_are_mahalanobis_in_the_shrunk_covariance():
    data = gaussians(0, dim=3, apart=2.0)
    fitted = fit(data, gaussians(1, dim=3, apart=2.0), READING)
    x = data.features.double().numpy()
    standard = (x - x.mean(0)) / x.std(0)
    means = {name: standard[[label == name for label in data.labels]].mean(0) for name in fitted.experts}
    residuals = standard - np.array([means[label] for label in data.labels])
    # Three components of three features: a rotation, under which the shrunk covariance rotates too.
    inverse = np.linalg.inv(ledoit_wolf(torch.tensor(residuals)).numpy())
    expected = [[np.sqrt((s - means[n]) @ inverse @ (s - means[n])) for n in fitted.experts] for s in standard[:5]]
    assert fitted.distances(data.features[:5]).numpy() == pytest.approx(np.array(expected), rel=1e-4)


def test_the_covariance_is_shrunk_by_ledoit_and_wolfs_amount():
    x = np.random.default_rng(0).normal(size=(20, 6)) @ np.diag([1, 1, 1, 2, 3, 4.0])
    n, p = x.shape
    sample = x.T @ x / n
    scale = np.trace(sample) / p
    d2 = ((sample - scale * np.eye(p)) ** 2).sum() / p
    b2 = min(d2, sum(((np.outer(row, row) - sample) ** 2).sum() / p for row in x) / n**2)
    expected = b2 / d2 * scale * np.eye(p) + (1 - b2 / d2) * sample
    assert ledoit_wolf(torch.tensor(x)).numpy() == pytest.approx(expected)
    assert 0 < b2 / d2 < 1


def test_fewer_frames_than_features_still_fit():
    few = fit(gaussians(0, count=4, dim=300), gaussians(1, count=4, dim=300), READING)
    assert few.whitening.shape[0] <= 15
    new = gaussians(2, dim=300)
    chosen = [few.experts[i] for i in few.scores(new.features).argmax(dim=1)]
    assert np.mean([a == b for a, b in zip(chosen, new.labels, strict=True)]) > 0.95


def test_an_outlier_is_far_and_known_ones_stay_under_the_threshold(calibration):
    outlier = torch.full((1, 12), 50.0)
    assert calibration.unknown(outlier) > calibration.threshold
    passed = (calibration.unknown(gaussians(3, count=250).features) <= calibration.threshold).double().mean()
    assert 0.9 < passed < 0.99


def test_the_order_of_frames_and_labels_changes_nothing(calibration):
    data = gaussians(0)
    order = torch.randperm(len(data.labels), generator=torch.Generator().manual_seed(0))
    shuffled = LabelledFeatures(data.features[order], tuple(data.labels[i] for i in order))
    again = fit(shuffled, gaussians(1), READING)
    new = gaussians(2).features
    assert torch.allclose(again.scores(new), calibration.scores(new), rtol=1e-4, atol=1e-4)


def test_a_constant_feature_is_harmless():
    def with_constant(data):
        return LabelledFeatures(torch.cat([data.features, torch.ones(len(data.labels), 1)], dim=1), data.labels)

    fitted = fit(with_constant(gaussians(0)), with_constant(gaussians(1)), READING)
    assert torch.isfinite(fitted.scores(with_constant(gaussians(2)).features)).all()


def test_the_temperature_lowers_overconfidence_and_is_at_least_one():
    generator = torch.Generator().manual_seed(0)
    logits = torch.randn(2000, 3, generator=generator).double() * 2
    truth = torch.distributions.Categorical(logits=logits).sample()
    assert temperature_of(logits * 5, truth) == pytest.approx(5.0, rel=0.15)
    assert temperature_of(torch.eye(3).double() * 9, torch.arange(3)) == 1.0


def test_the_threshold_is_the_conformal_quantile():
    assert conformal_threshold(torch.arange(1.0, 101.0)) == 96.0
    assert conformal_threshold(torch.arange(5.0)) == 4.0
    with pytest.raises(RoutingError, match="expected held-out first observations"):
        conformal_threshold(torch.empty(0))


def test_a_calibration_is_read_back_from_tensors(calibration):
    tensors = calibration.as_tensors()
    back = GaussianRouterFit.from_tensors(tensors)
    assert back.as_tensors().keys() == tensors.keys()
    assert all(torch.equal(tensors[name], tensor) for name, tensor in back.as_tensors().items())
    assert (back.experts, back.feature_spec) == (calibration.experts, calibration.feature_spec)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("centres", None, r"expected centres as numbers of shape \(4, 12\), got none"),
        ("whitening", torch.eye(3), r"expected whitening .* \(any, 12\), got \(3, 3\)"),
        ("mean", torch.full((12,), torch.nan), "expected a finite mean, got NaN"),
        ("temperature", torch.tensor(0.0), "expected a temperature above 0, got 0"),
        ("experts", torch.tensor([255], dtype=torch.uint8), "expected experts as names in UTF-8"),
        ("reading", torch.tensor([1, -1, 7]), "expected three whole numbers"),
    ],
)
def test_malformed_tensors_are_refused(calibration, name, value, message):
    tensors = {**calibration.as_tensors(), name: value}
    with pytest.raises(RoutingError, match=message):
        GaussianRouterFit.from_tensors({key: tensor for key, tensor in tensors.items() if tensor is not None})


def test_features_that_do_not_fit_are_refused(calibration):
    with pytest.raises(RoutingError, match=r"expected features of shape \(n, 12\), got \(1, 13\)"):
        calibration.distances(torch.zeros(1, 13))
    with pytest.raises(RoutingError, match=r"expected features of shape \(2, d\), one row per label, got \(3, 4\)"):
        LabelledFeatures(torch.zeros(3, 4), ("a", "b"))
    with pytest.raises(RoutingError, match="expected finite features"):
        LabelledFeatures(torch.full((1, 2), torch.inf), ("a",))
    with pytest.raises(RoutingError, match="expected held-out first observations of a, b, c, d, got a, b, c"):
        fit(gaussians(0), gaussians(1).without("d"), READING)
    same = LabelledFeatures(torch.ones(4, 3), ("a", "a", "b", "b"))
    with pytest.raises(RoutingError, match="expected first observations that differ"):
        fit(same, same, READING)
    twice = LabelledFeatures(torch.tensor([[0.0], [0.0], [1.0], [1.0]]), ("a", "a", "b", "b"))
    with pytest.raises(RoutingError, match=r"differ within a task, .*; give it more demonstrations"):
        fit(twice, twice, READING)
