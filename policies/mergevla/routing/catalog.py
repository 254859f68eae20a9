"""Routers by name, and the fitting of those that learn from first frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from torch import Tensor

from policies.mergevla.config import Architecture
from policies.mergevla.routing import gaussian
from policies.mergevla.routing.centroids import Centroids, fit_centres
from policies.mergevla.routing.contract import Candidates, Router, RoutingError, Sighting
from policies.mergevla.routing.controls import InstructionMatchRouter, OracleRouter, RandomRouter
from policies.mergevla.routing.features import Labelled, Reading, labelled
from policies.mergevla.routing.fitted import Fitted, FittedRouter
from policies.mergevla.routing.gaussian import Calibration
from policies.mergevla.routing.subspace import PaperCodedRouter, PaperWrittenRouter
from policies.mergevla.routing.variation import varied
from suites.plugins import nearest

UNFITTED: Mapping[str, Callable[..., Router]] = {
    router.name: router
    for router in (PaperCodedRouter, PaperWrittenRouter, RandomRouter, InstructionMatchRouter, OracleRouter)
}
"""Routers that need the candidates only."""


@dataclass(frozen=True)
class Fitting:
    """How a router is fitted, and read again."""

    fit: Callable[..., Fitted]
    """Takes `frames` for the classes, `held_out` ones (both `Labelled`), and the `reading` that they are of."""
    read: Callable[[Mapping[str, Tensor]], Fitted]
    """The inverse of `Fitted.as_tensors`."""
    varies: bool
    """Whether the classes are fitted to varied first frames, beside those that came (`variation.varied`)."""


FITTED: Mapping[str, Fitting] = {
    "calibrated": Fitting(gaussian.fit, Calibration.from_tensors, varies=True),
    "nearest-centroid": Fitting(fit_centres, Centroids.from_tensors, varies=False),
}
"""Routers that are fitted to first frames."""
NAMES = tuple(sorted([*UNFITTED, *FITTED]))
"""All routers."""


def router(name: str, *, sees_instruction: bool = True, stored: Mapping[str, Tensor] | None = None) -> Router:
    """The router of that name.

    Args:
        name: One of `NAMES`.
        sees_instruction: False blanks the instruction while routing.
        stored: What `fit_routers` gave, for routers that are fitted.

    Raises:
        RoutingError: Unknown name, or a router that is not fitted or whose tensors do not read.
    """
    if name in UNFITTED:
        return UNFITTED[name](sees_instruction=sees_instruction)
    if name not in FITTED:
        raise RoutingError(f"unknown router '{name}'{nearest(name, NAMES)}")
    prefix = _prefix(name, sees_instruction=sees_instruction)
    tensors = {key.removeprefix(prefix): tensor for key, tensor in (stored or {}).items() if key.startswith(prefix)}
    if not tensors:
        raise RoutingError(f"router '{name}': expected tensors {prefix}* fitted to first frames, got none")
    try:
        return FittedRouter(name, FITTED[name].read(tensors))
    except RoutingError as error:
        raise RoutingError(f"router '{name}': {error}; merge again with --demonstrations") from None


def fit_routers(
    candidates: Candidates,
    frames: Mapping[str, Sequence[Sighting]],
    held_out: Mapping[str, Sequence[Sighting]],
) -> dict[str, Tensor]:
    """Fit every router that can be fitted, with the instruction and without.

    Args:
        candidates: Of which only the base is run.
        frames: Expert to first observations for its class.
        held_out: Expert to others, for temperature and thresholds.

    Returns:
        Tensors by `<router>/<instructed | unaided>/<name>`, for a safetensors file.

    Raises:
        RoutingError: An expert without frames, or frames that do not tell anything apart.
    """
    tensors: dict[str, Tensor] = {}
    for sees_instruction in (True, False):
        reading = reading_of(candidates.architecture, sees_instruction=sees_instruction)
        for name, fitting in FITTED.items():
            prefix = _prefix(name, sees_instruction=sees_instruction)
            parts = to_fit(fitting, candidates, frames, held_out, reading)
            fitted = fitting.fit(*parts, reading=reading).as_tensors()
            tensors |= {prefix + key: tensor.contiguous() for key, tensor in fitted.items()}
    return tensors


def reading_of(architecture: Architecture, *, sees_instruction: bool) -> Reading:
    """What fitted routers read: hidden states in the middle of the base.

    The last ones hold what the actions need. What else lies in the scene, by which an unknown task is told where no
    instruction is read, is still there in the middle.
    """
    return Reading(sees_instruction, layer=architecture.language.layers // 2)


def to_fit(
    fitting: Fitting,
    candidates: Candidates,
    frames: Mapping[str, Sequence[Sighting]],
    held_out: Mapping[str, Sequence[Sighting]],
    reading: Reading,
) -> tuple[Labelled, Labelled]:
    """Features for the classes, varied or not, and for temperature and threshold, of held-out frames as they come.

    Args:
        fitting: Which says whether to vary.
        candidates: Of which only the base is run.
        frames: Expert to first observations.
        held_out: Expert to others.
        reading: What to read.

    Raises:
        RoutingError: An expert without frames.
    """
    if fitting.varies:
        frames = {expert: varied(own, sees_instruction=reading.sees_instruction) for expert, own in frames.items()}
    return labelled(candidates, frames, reading), labelled(candidates, held_out, reading)


def _prefix(name: str, *, sees_instruction: bool) -> str:
    return f"{name}/{'instructed' if sees_instruction else 'unaided'}/"
