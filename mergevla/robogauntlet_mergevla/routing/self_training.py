"""The router `self-trained`: the calibrated router's classifier, fitted to first observations without labels.

The labels are the model's own. Evidence from the experts' weights and actions, standardised for each expert over all
observations, gives the first: on a base that has learned the tasks, an expert is at home where its delta acts little
and it acts as the base does; on one that has not, where its actions hardly change with noise on the images. Then a
classifier is fitted and labels the observations again, until the labels stay (self-training: H. Scudder, "Probability
of error of some adaptive pattern-recognition machines", 1965).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
from robogauntlet_mergevla.routing import gaussian
from robogauntlet_mergevla.routing.augmentation import augmented
from robogauntlet_mergevla.routing.contract import FirstObservation, RoutingError
from robogauntlet_mergevla.routing.deltas import agreement, directions, energies, stability
from robogauntlet_mergevla.routing.features import (
    FeatureSpec,
    LabelledFeatures,
    features_of,
    labelled_features,
)
from robogauntlet_mergevla.routing.fitted_router import conformal_threshold
from robogauntlet_mergevla.routing.gaussian import GaussianRouterFit

RANK = 24
"""Right singular vectors of a delta that count as its row space."""
ROUNDS = 10
COMPONENTS = 64
"""Principal components of the classifiers that label the observations again."""
MOST = 360
"""Most observations that are used; others are left out evenly."""
FAMILIAR = -0.12
"""A base whose actions agree less with those of the likeliest expert (median) has not learned the tasks. Chosen between
the zoo's nine experts (-0.06) and those of LIBERO (-0.21), on training and development seeds."""
LANGUAGE = "language."
"""Layers that read words, too; all others read only images."""


def fit_self_trained(
    model: MergedModel,
    observations: Sequence[FirstObservation],
    held_out: Sequence[FirstObservation],
    feature_specs: Sequence[FeatureSpec],
) -> list[GaussianRouterFit]:
    """Fit a router for each of `feature_specs`; whether it reads the instruction decides whether its labels do.

    Args:
        model: Merged model.
        observations: First observations of the experts' tasks, from several episodes of each. Their tasks are not read.
        held_out: Other observations, for the threshold.
        feature_specs: Features of the routers.

    Raises:
        RoutingError: Fewer observations than experts, or no layer differs from the base's.
    """
    observations = observations[:: max(1, math.ceil(len(observations) / MOST))]
    if not held_out:
        raise RoutingError("expected held-out first observations for a rejection threshold, got none")
    if len(observations) < len(model.experts):
        raise RoutingError(f"expected {len(model.experts)} first observations or more, got {len(observations)}")
    agreed = agreement(model, observations)
    unfamiliar = bool(agreed.amax(dim=1).median() < FAMILIAR)
    stable = standardised(stability(model, observations)) if unfamiliar else None
    agreed, rows = standardised(agreed), directions(model, RANK)
    fits = []
    for spec in feature_specs:
        found = -energies(model, rows, observations, sees_instruction=spec.sees_instruction)
        images = [place for place, name in enumerate(rows) if not name.startswith(LANGUAGE)]
        parts = (found.sum(dim=1), found[:, images].sum(dim=1), agreed)
        evidence = sum(map(standardised, parts)) if stable is None else stable
        labels = self_labels(evidence, features_of(model, observations, spec), spec)
        frames = {
            expert: [observations[i] for i in labels.eq(place).nonzero()] for place, expert in enumerate(model.experts)
        }
        known = labelled_features(model, frames, spec)
        more = {expert: augmented(own, sees_instruction=spec.sees_instruction) for expert, own in frames.items()}
        fitted = gaussian.fit(labelled_features(model, more, spec), known, spec)
        fits.append(replace(fitted, threshold=conformal_threshold(fitted.unknown(features_of(model, held_out, spec)))))
    return fits


def self_labels(evidence: Tensor, features: Tensor, feature_spec: FeatureSpec) -> Tensor:
    """Return the index of an expert for each observation, shape (n,), every expert at least once.

    Args:
        evidence: Higher for the likelier expert, shape (n, experts), n >= experts.
        features: Shape (n, d).
        feature_spec: What the features are.
    """
    labels = _each_once(evidence)
    for _ in range(ROUNDS):
        named = LabelledFeatures(features, tuple(f"{place:06}" for place in labels.tolist()))
        fitted = gaussian.fit(named, named, feature_spec, COMPONENTS)
        again = _each_once(fitted.scores(features))
        if again.equal(labels):
            break
        labels = again
    return labels


def standardised(columns: Tensor) -> Tensor:
    """Each expert's column (n, experts) with mean 0 and deviation 1; a constant one is 0."""
    centred = columns - columns.mean(dim=0)
    deviation = centred.square().mean(dim=0).sqrt()
    return torch.where(deviation > 0, centred / deviation.clamp(min=1e-30), 0.0)


def _each_once(scores: Tensor) -> Tensor:
    """The best expert of each row, and for an expert that is nowhere the best, the row in which it is nearest to it."""
    labels, behind = scores.argmax(dim=1), scores - scores.amax(dim=1, keepdim=True)
    for place in range(scores.shape[1]):
        if not labels.eq(place).any():
            counts = torch.bincount(labels, minlength=scores.shape[1])
            behind_here = torch.where(counts[labels] > 1, behind[:, place], -torch.inf)
            labels[behind_here.argmax()] = place
    return labels
