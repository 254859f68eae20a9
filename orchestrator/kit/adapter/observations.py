"""Observations show the present, belong to the caller, and are rendered only on request."""

from __future__ import annotations

import cProfile
import pstats
import re
from collections.abc import Callable, Iterator, Mapping, Sequence

from robogauntlet.orchestrator.kit.adapter.check import NotApplicable, Violation, check, expect
from robogauntlet.orchestrator.kit.adapter.checked_task import CheckedTask, changed

Function = tuple[str, int, str]
"""File, line, name."""
REPEATS = 6
SHARE = 0.4
"""Share of the time of an observation that a function must take to count as the renderer."""
ALIKE = 0.25
"""Share of the rendering time in an observation above which a step renders too."""
WAITING = {"recv", "recv_into", "poll", "select", "acquire", "wait", "sleep"}
"""Calls by which a simulator in another process is recognised."""


@check("present", look="Simulation.observe: buffers that are filled during step or reset", renders=True)
def present(subject: CheckedTask) -> Iterator[Violation]:
    """An observation shows the present."""
    simulation = subject.reset()
    before = simulation.observe()
    height, sideways = map(subject.length, (0.01, 0.02))
    for _ in range(10):
        simulation.step(subject.moving(dy=sideways, dz=height))
    after = simulation.observe()
    for camera in before.images:
        moved = changed(before.images[camera], after.images[camera], by=30) > 0.0
        yield from expect(moved, f"{camera} to show that the tool has moved by 10 steps", "the same image")


@check("own-images", look="Simulation.observe: copy what the renderer overwrites", renders=True)
def own_images(subject: CheckedTask) -> Iterator[Violation]:
    """An observation belongs to the caller: later ones do not overwrite it."""
    simulation = subject.reset()
    first = simulation.observe()
    copies = {camera: image.copy() for camera, image in first.images.items()}
    proprioception = first.proprioception.copy()
    for action in subject.random_actions(0, 8):
        simulation.step(action)
    simulation.observe()
    for camera, image in copies.items():
        same = (first.images[camera] == image).all()
        yield from expect(same, f"the first image of {camera} to stay as it was", "a later observation has changed it")
    same = (first.proprioception == proprioception).all()
    yield from expect(same, "the first proprioception to stay as it was", "later steps have changed it")


@check("step-draws-nothing", look="Simulation.step: only observe may render", renders=True)
def step_draws_nothing(subject: CheckedTask) -> Iterator[Violation]:
    """A step never renders.

    The function that takes longest in an observation must not take as long in a step. Rendering that is not called
    from Python is not detected.
    """
    simulation, action = subject.reset(), subject.action()
    simulation.observe()
    observations, steps = [], []
    for _ in range(REPEATS):  # in turns, so that other load on the machine slows down both
        observations.append(_own_seconds(simulation.observe))
        steps.append(_own_seconds(lambda: simulation.step(action)))
    observing, stepping = _least(observations), _least(steps)
    renderer = max(observing, key=lambda function: observing[function])
    if observing[renderer] < SHARE * sum(observing.values()):
        raise NotApplicable("no function of an observation takes long enough to be the renderer")
    if WAITING.intersection(re.findall(r"\w+", renderer[2])):
        raise NotApplicable("the simulator runs in another process, where calls cannot be distinguished")
    spent = stepping.get(renderer, 0.0)
    yield from expect(
        spent <= ALIKE * observing[renderer],
        "a step that does not render",
        f"it spends {1000 * spent:.1f} ms in {renderer[2]}, which renders the observations",
    )


def _least(calls: Sequence[Mapping[Function, float]]) -> dict[Function, float]:
    """Shortest time of each function in any of the calls (s), so that interruptions do not count."""
    return {function: min(seconds.get(function, 0.0) for seconds in calls) for function in calls[0]}


def _own_seconds(call: Callable[[], object]) -> dict[Function, float]:
    """Time that a call spends in each function itself (s)."""
    profile = cProfile.Profile()
    profile.runcall(call)
    stats = pstats.Stats(profile).stats  # type: ignore[attr-defined]
    return {function: own for function, (_, _, own, _, _) in stats.items()}


CHECKS = (present, own_images, step_draws_nothing)
