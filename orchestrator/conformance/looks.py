"""Looking: observations show the present, belong to the caller, and are drawn when they are asked for only."""

from __future__ import annotations

import cProfile
import pstats
import re
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from orchestrator.conformance.findings import Fault, NotApplicable, check
from orchestrator.conformance.subject import Subject

Function = tuple[str, int, str]
"""File, line, name."""
REPEATS = 6
SHARE = 0.4
"""Share of the time of a look below which nothing stands out as what draws."""
ALIKE = 0.25
"""Share of the time that drawing takes in a look beyond which a step draws too."""
WAITING = {"recv", "recv_into", "poll", "select", "acquire", "wait", "sleep"}
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
    simulation, action = subject.reset(), subject.action()
    simulation.observe()
    looks, steps = [], []
    for _ in range(REPEATS):  # in turns, so that what else the machine does slows down both
        looks.append(_own_seconds(simulation.observe))
        steps.append(_own_seconds(lambda: simulation.step(action)))
    looking, stepping = _least(looks), _least(steps)
    draws = max(looking, key=lambda function: looking[function])
    if looking[draws] < SHARE * sum(looking.values()):
        raise NotApplicable("nothing in a look takes so long that it must be what draws")
    if WAITING.intersection(re.findall(r"\w+", draws[2])):
        raise NotApplicable("the simulator runs in another process, where calls cannot be told apart")
    if stepping.get(draws, 0.0) > ALIKE * looking[draws]:
        name, spent = draws[2], 1000 * stepping[draws]
        yield Fault("a step that does not draw", f"it spends {spent:.1f} ms in {name}, which is what draws in a look")


def _least(calls: Sequence[Mapping[Function, float]]) -> dict[Function, float]:
    """Seconds of each function in the call in which it took least: whatever interrupted it did not take its time."""
    return {function: min(own.get(function, 0.0) for own in calls) for function in calls[0]}


def _own_seconds(call: Callable[[], object]) -> dict[Function, float]:
    """Seconds that a call spends in each function itself."""
    profile = cProfile.Profile()
    profile.runcall(call)
    stats = pstats.Stats(profile).stats  # type: ignore[attr-defined]
    return {function: own for function, (_, _, own, _, _) in stats.items()}


CHECKS = (present, own_images, step_draws_nothing)
