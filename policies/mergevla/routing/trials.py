"""Puts every router to the test on first observations: what it chooses, and how long one decision takes."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from torch import Tensor

from policies.mergevla.routing.catalog import FITTED, NAMES, reading_of, router, to_fit
from policies.mergevla.routing.contract import Candidates, Router, RoutingError, Sighting
from policies.mergevla.routing.demonstrations import FirstSightings
from policies.mergevla.routing.features import labelled
from policies.mergevla.routing.study import LeftOut, Study, Trial, leave_one_out, study

Listener = Callable[[int, int], None]
"""Told how many of how many are done."""


@dataclass(frozen=True)
class Judged:
    """A router's record."""

    router: str
    sees_instruction: bool
    passes: int
    """Backbone passes for one decision."""
    study: Study
    relative_latency: float
    """Median time of a decision, in medians of one backbone pass."""


@dataclass(frozen=True)
class Judgement:
    """All routers on the same sightings."""

    pass_s: float
    """Median time of one pass of the base over one sighting (s)."""
    routers: tuple[Judged, ...]


@dataclass(frozen=True)
class UnknownTasks:
    """How well a fitted router notices each task that it was not fitted to."""

    router: str
    sees_instruction: bool
    left_out: LeftOut


def all_routers(stored: Mapping[str, Tensor]) -> list[Router]:
    """Every router, with the instruction and without; those that take fitting only if they were.

    Args:
        stored: What `catalog.fit_routers` gave.

    Raises:
        RoutingError: Tensors that do not read.
    """
    fitted = {key.partition("/")[0] for key in stored}
    names = [name for name in NAMES if name not in FITTED or name in fitted]
    return [router(name, sees_instruction=sees, stored=stored) for name in names for sees in (True, False)]


def judge(
    routers: Sequence[Router],
    candidates: Candidates,
    sightings: Sequence[Sighting],
    *,
    listener: Listener = lambda done, wanted: None,
    clock: Callable[[], float] = time.perf_counter,
) -> Judgement:
    """Route each sighting by each router, one at a time.

    A pass is timed beside the routers at every sighting, so that whatever else the machine does slows all alike. What
    is made at the first use only is made before.

    Args:
        routers: To judge.
        candidates: The merged model.
        sightings: Of tasks that have an expert.
        listener: See `Listener`.
        clock: Seconds, from anywhere.

    Raises:
        RoutingError: No sightings, or what a router raises.
    """
    if not sightings:
        raise RoutingError("expected first observations to route, got none")
    _pass(candidates, sightings[0])
    for one in routers:
        one.route(sightings[:1], candidates)
    trials: list[list[Trial]] = [[] for _ in routers]
    pass_times = []
    for done, sighting in enumerate(sightings):
        listener(done, len(sightings))
        started = clock()
        _pass(candidates, sighting)
        pass_times.append(clock() - started)
        for one, record in zip(routers, trials, strict=True):
            started = clock()
            (routed,) = one.route([sighting], candidates)
            record.append(Trial(sighting.task, routed, clock() - started))
    listener(len(sightings), len(sightings))
    pass_s = float(np.median(pass_times))
    return Judgement(pass_s, tuple(_judged(*one, candidates, pass_s) for one in zip(routers, trials, strict=True)))


def unknown_tasks(
    candidates: Candidates,
    fitted_to: FirstSightings,
    judged: Mapping[str, Sequence[Sighting]],
    *,
    listener: Listener = lambda done, wanted: None,
) -> list[UnknownTasks]:
    """Leave each task in turn out of the fit, and see whether its sightings are called unknown.

    Args:
        candidates: Of which only the base is run.
        fitted_to: Of all experts.
        judged: Task to new sightings, never fitted to.
        listener: Told how many of how many fits are judged.

    Raises:
        RoutingError: Fewer than two tasks are judged.
    """
    found: list[UnknownTasks] = []
    wanted = 2 * len(FITTED)
    for sees_instruction in (True, False):
        listener(len(found), wanted)
        reading = reading_of(candidates.architecture, sees_instruction=sees_instruction)
        new = labelled(candidates, judged, reading)
        for name, fitting in FITTED.items():
            parts = to_fit(fitting, candidates, fitted_to.frames, fitted_to.held_out, reading)
            left_out = leave_one_out(partial(fitting.fit, reading=reading), *parts, new)
            found.append(UnknownTasks(name, sees_instruction, left_out))
    return sorted(found, key=lambda one: one.router)


def _judged(router: Router, trials: Sequence[Trial], candidates: Candidates, pass_s: float) -> Judged:
    found = study(trials)
    assert found.latency is not None
    passes = router.passes(len(candidates.experts))
    return Judged(router.name, router.sees_instruction, passes, found, found.latency.median_s / pass_s)


@torch.no_grad()
def _pass(candidates: Candidates, sighting: Sighting) -> None:
    """One pass of the base over one sighting, waited for."""
    candidates.hidden_states(None, sighting.images[None], [sighting.instruction]).action[-1].sum().item()
