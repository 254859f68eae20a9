"""Looking: observations show the present, belong to the caller, and are drawn when they are asked for only."""

from __future__ import annotations

import cProfile
import pstats
from collections.abc import Callable, Iterator

import numpy as np

from orchestrator.conformance.findings import Fault, NotApplicable, check
from orchestrator.conformance.subject import Subject

REPEATS = 6
SHARE = 0.4
"""Share of the time of a look below which nothing stands out as what draws."""
WAITING = ("recv", "read", "poll", "select", "acquire", "wait", "sleep")
"""Calls that say that the simulator runs elsewhere."""


@check("present", look="Simulation.observe: buffers that are filled during step or reset", renders=True)
def present(subject: Subject) -> Iterator[Fault]:
    """An observation shows the present."""
    simulation = subject.reset()
    before = simulation.observe()
    height, sideways = np.minimum([0.01, 0.02], simulation.action_spec.max_translation)
    for _ in range(10):
        simulation.step(subject.action(dy=sideways, dz=height))
    after = simulation.observe()
    for camera in before.images:
        change = np.abs(before.images[camera].astype(int) - after.images[camera])
        if not (change > 30).any():
            yield Fault(f"{camera} to show that the tool has moved by 10 steps", "the same image")


@check("own-images", look="Simulation.observe: copy what the renderer overwrites", renders=True)
def own_images(subject: Subject) -> Iterator[Fault]:
    """An observation is the caller's own: later ones do not overwrite it."""
    simulation = subject.reset()
    first = simulation.observe()
    kept = {camera: image.copy() for camera, image in first.images.items()}
    proprioception = first.proprioception.copy()
    for action in subject.random_actions(0, 8):
        simulation.step(action)
    simulation.observe()
    for camera, image in kept.items():
        if (first.images[camera] != image).any():
            yield Fault(f"the first image of {camera} to stay as it was", "a later look has changed it")
    if (first.proprioception != proprioception).any():
        yield Fault("the first proprioception to stay as it was", "later steps have changed it")


@check("step-draws-nothing", look="Simulation.step: whatever renders belongs into observe", renders=True)
def step_draws_nothing(subject: Subject) -> Iterator[Fault]:
    """A step never renders.

    Found by what takes longest in a look, which must not take as long in a step. What draws without being called from
    Python is not found.
    """
    simulation = subject.reset()
    simulation.observe()
    looking, total = _own_seconds(simulation.observe)
    draws = max(looking, key=lambda function: looking[function])
    if looking[draws] < SHARE * total:
        raise NotApplicable("nothing in a look takes so long that it must be what draws")
    if any(word in draws[2] for word in WAITING):
        raise NotApplicable("the simulator runs in another process, where calls cannot be told apart")
    action = subject.action()
    stepping, _ = _own_seconds(lambda: simulation.step(action))
    if stepping.get(draws, 0.0) > 0.5 * looking[draws]:
        name, spent = draws[2], 1000 * stepping[draws] / REPEATS
        yield Fault("a step that does not draw", f"it spends {spent:.1f} ms in {name}, which is what draws in a look")


def _own_seconds(call: Callable[[], object]) -> tuple[dict[tuple[str, int, str], float], float]:
    """Seconds spent in each function itself (file, line, name) during some calls, and in all."""
    profile = cProfile.Profile()
    for _ in range(REPEATS):
        profile.runcall(call)
    found = pstats.Stats(profile)
    own = {function: own for function, (_, _, own, _, _) in found.stats.items()}  # type: ignore[attr-defined]
    return own, sum(own.values())


CHECKS = (present, own_images, step_draws_nothing)
