"""Routers by name, and the fitting of those that learn from first observations."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain

from torch import Tensor

from robogauntlet.suites.plugins import did_you_mean
from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
from robogauntlet_mergevla.network.config import Architecture
from robogauntlet_mergevla.routing import gaussian
from robogauntlet_mergevla.routing.augmentation import augmented
from robogauntlet_mergevla.routing.baselines import InstructionMatchRouter, OracleRouter, RandomRouter
from robogauntlet_mergevla.routing.contract import FirstObservation, Router, RoutingError
from robogauntlet_mergevla.routing.deltas import DeltaEnergyRouter
from robogauntlet_mergevla.routing.features import FeatureSpec, LabelledFeatures, labelled_features
from robogauntlet_mergevla.routing.fitted_router import FittedRouter, RouterFit, fit_centroids
from robogauntlet_mergevla.routing.gaussian import GaussianRouterFit
from robogauntlet_mergevla.routing.self_training import fit_self_trained
from robogauntlet_mergevla.routing.subspace import PaperCodedRouter, PaperWrittenRouter, SubspaceOptions

SUBSPACES = {router.kind: router for router in (PaperCodedRouter, PaperWrittenRouter)}
"""Routers with options, which follow the name and a colon: `paper-coded:projections=kv,rank=16`."""
UNFITTED: Mapping[str, Callable[..., Router]] = {
    **SUBSPACES,
    **{router.name: router for router in (RandomRouter, InstructionMatchRouter, OracleRouter, DeltaEnergyRouter)},
}
"""Routers that need no fitting."""


@dataclass(frozen=True)
class FitMethod:
    """How a router is fitted and restored from tensors."""

    fit: Callable[..., RouterFit]
    """Takes `frames` for the classes, `held_out` ones (both `LabelledFeatures`), and their `feature_spec`."""
    read: Callable[[Mapping[str, Tensor]], RouterFit]
    """The inverse of `RouterFit.as_tensors`."""
    augments: bool
    """Whether the classes are also fitted to augmented observations."""


@dataclass(frozen=True)
class UnlabelledFit:
    """How a router is fitted to observations without their tasks, and restored from tensors."""

    fit: Callable[..., Sequence[RouterFit]]
    """Takes the model, observations for the classes, held-out ones, and a list of feature specs; a fit for each."""
    read: Callable[[Mapping[str, Tensor]], RouterFit]
    """The inverse of `RouterFit.as_tensors`."""


FITTED: Mapping[str, FitMethod | UnlabelledFit] = {
    "calibrated": FitMethod(gaussian.fit, GaussianRouterFit.from_tensors, augments=True),
    "nearest-centroid": FitMethod(fit_centroids, RouterFit.from_tensors, augments=False),
    "self-trained": UnlabelledFit(fit_self_trained, GaussianRouterFit.from_tensors),
}
"""Routers that are fitted to first observations, the last one without their tasks."""
NAMES = tuple(sorted([*UNFITTED, *FITTED]))
"""All routers of this package."""


def router(name: str, *, sees_instruction: bool = True, stored: Mapping[str, Tensor] | None = None) -> Router:
    """Return the router of that name, which needs the result of `fit_routers` (`stored`) if it is a fitted one.

    Without `sees_instruction`, the instruction is blanked while routing. Options follow the name and a colon. Raises
    RoutingError for an unknown name or option, or a router that was not fitted or whose tensors are malformed.
    """
    plain, colon, options = name.partition(":")
    if plain in SUBSPACES:
        try:
            return SUBSPACES[plain](SubspaceOptions.read(options), sees_instruction=sees_instruction)
        except RoutingError as error:
            raise RoutingError(f"router '{name}': {error}") from None
    if colon and plain in NAMES:
        raise RoutingError(f"router '{name}': expected a router with options, {' or '.join(SUBSPACES)}, got '{plain}'")
    if name in UNFITTED:
        return UNFITTED[name](sees_instruction=sees_instruction)
    if name not in FITTED:
        raise RoutingError(f"unknown router '{name}'{did_you_mean(name, NAMES)}")
    prefix = _prefix(name, sees_instruction=sees_instruction)
    tensors = {key.removeprefix(prefix): tensor for key, tensor in (stored or {}).items() if key.startswith(prefix)}
    if not tensors:
        raise RoutingError(f"router '{name}': expected tensors {prefix}* fitted to first observations, got none")
    try:
        return FittedRouter(name, FITTED[name].read(tensors))
    except RoutingError as error:
        raise RoutingError(f"router '{name}': {error}; merge again with --demonstrations") from None


def fit_routers(
    model: MergedModel,
    frames: Mapping[str, Sequence[FirstObservation]],
    held_out: Mapping[str, Sequence[FirstObservation]],
    names: Collection[str] = (),
) -> dict[str, Tensor]:
    """Fit routers, with the instruction and without.

    Args:
        model: Merged model, of which only the base is run.
        frames: Task of an expert to first observations for its class.
        held_out: Task to other observations, for temperature and thresholds.
        names: Routers of `FITTED` to fit; by default all.

    Returns:
        Tensors by `<router>/<instructed | unaided>/<name>`, for a safetensors file.

    Raises:
        RoutingError: A task without observations, observations that are all the same, or too few for a router that is
            named.
    """
    specs = [feature_spec_of(model.architecture, sees_instruction=sees) for sees in (True, False)]
    fits: list[tuple[str, RouterFit]] = []
    pool, others = (list(chain.from_iterable(part.values())) for part in (frames, held_out))
    for name in names or FITTED:
        fitting = FITTED[name]
        if isinstance(fitting, UnlabelledFit):
            fits += [(name, fitted) for fitted in fitting.fit(model, pool, others, specs)]
            continue
        for spec in specs:
            parts = fitting_features(fitting, model, frames, held_out, spec)
            fits.append((name, fitting.fit(*parts, feature_spec=spec)))
    return {
        _prefix(name, sees_instruction=fitted.feature_spec.sees_instruction) + key: tensor.contiguous()
        for name, fitted in fits
        for key, tensor in fitted.as_tensors().items()
    }


def feature_spec_of(architecture: Architecture, *, sees_instruction: bool) -> FeatureSpec:
    """Return the features of fitted routers: hidden states of the base's middle layer.

    The last layer keeps what actions need; the middle one still represents the rest of the scene, by which an unknown
    task is recognised when no instruction is read.
    """
    return FeatureSpec(sees_instruction, layer=architecture.language.layers // 2)


def fitting_features(
    fitting: FitMethod,
    model: MergedModel,
    frames: Mapping[str, Sequence[FirstObservation]],
    held_out: Mapping[str, Sequence[FirstObservation]],
    feature_spec: FeatureSpec,
) -> tuple[LabelledFeatures, LabelledFeatures]:
    """Return the features for the classes, augmented if `fitting` says so, and those of the held-out observations.

    Raises RoutingError if a task has no observations.
    """
    if fitting.augments:
        sees = feature_spec.sees_instruction
        frames = {expert: augmented(observations, sees_instruction=sees) for expert, observations in frames.items()}
    return labelled_features(model, frames, feature_spec), labelled_features(model, held_out, feature_spec)


def _prefix(name: str, *, sees_instruction: bool) -> str:
    return f"{name}/{'instructed' if sees_instruction else 'unaided'}/"
