"""Equal seeds give equal worlds: whatever was played before, whoever looks, in whatever process."""

from __future__ import annotations

import hashlib
import random
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from adapters.contract import Observation, Simulation
from orchestrator.conformance.findings import Fault, check
from orchestrator.conformance.processes import ask_elsewhere
from orchestrator.conformance.subject import CLEAN, Subject, exact

SEEDS = range(4)
STEPS = 40
LOOKS_EVERY = 8


@dataclass(frozen=True)
class Trace:
    """What was seen of an episode of fixed actions."""

    start: str
    """State hash after the reset."""
    end: str
    """State hash after the last step."""
    exact_end: str
    """The privileged state after the last step, to the bit."""
    looks: tuple[str, ...] = ()
    """Digests of what was seen, if anyone looked."""


def trace(subject: Subject, seed: int, *, look: bool = False, on: Simulation | None = None) -> Trace:
    """Play fixed actions from a seed.

    Args:
        subject: The task.
        seed: Of the episode, and of the actions.
        look: Whether to look after the reset and every few steps.
        on: Another simulation of the task than the shared one.
    """
    simulation = on or subject.simulation
    _disturb(seed)
    simulation.reset(seed, CLEAN)
    start, looks = simulation.state_hash(), []
    for number, action in enumerate(subject.random_actions(seed, STEPS)):
        if look and number % LOOKS_EVERY == 0:
            looks.append(digest(simulation.observe()))
        simulation.step(action)
    return Trace(start, simulation.state_hash(), exact(simulation.privileged_state()), tuple(looks))


def digest(seen: Observation) -> str:
    """Of an observation, to the bit."""
    found = hashlib.sha256(seen.proprioception.tobytes())
    for camera in sorted(seen.images):
        found.update(camera.encode() + np.ascontiguousarray(seen.images[camera]).tobytes())
    return found.hexdigest()[:16]


def _disturb(seed: int) -> None:
    """Leave the process's own generators in another state each time: an adapter that reads them is found out."""
    random.seed()
    np.random.seed(None)
    np.random.random(seed + 1)


@check("seeds", look="Simulation.reset: generators, contact caches, solver and controller memory")
def seeds(subject: Subject) -> Iterator[Fault]:
    """An equal seed gives an equal episode, to the bit, whatever was played before."""
    forwards = {seed: trace(subject, seed) for seed in SEEDS}
    backwards = {seed: trace(subject, seed) for seed in reversed(SEEDS)}
    for seed in SEEDS:
        one, other = forwards[seed], backwards[seed]
        if one.start != other.start:
            yield Fault(
                f"seed {seed} to start alike after other episodes", f"state hash {one.start}, then {other.start}"
            )
        elif one != other:
            yield Fault(
                f"seed {seed} to end alike after the same {STEPS} actions",
                f"state hash {one.end}, then {other.end}"
                + (", which differ in the last bits only" if one.end == other.end else ""),
            )
    if len({found.start for found in forwards.values()}) < len(SEEDS):
        yield Fault("other seeds to start differently", f"{len({f.start for f in forwards.values()})} of {len(SEEDS)}")


@check("seeds-images", look="what is drawn and not in the state: lights, textures, cameras, caches", renders=True)
def seeds_images(subject: Subject) -> Iterator[Fault]:
    """An equal seed gives equal images, to the bit, whatever was played and looked at before."""
    first = {}
    for seed in SEEDS[:2]:
        first[seed] = digest(subject.reset(seed).observe())
    for seed in reversed(SEEDS[:2]):
        if digest(subject.reset(seed).observe()) != first[seed]:
            yield Fault(f"the images of seed {seed} again", "others")


@check("looking", look="Simulation.observe: it must not step, settle, or write to the world")
def looking(subject: Subject) -> Iterator[Fault]:
    """Looking changes nothing of what follows."""
    simulation = subject.reset(1)
    before = simulation.state_hash()
    simulation.observe()
    if simulation.state_hash() != before:
        yield Fault("the same state before and after a look", f"{before}, then {simulation.state_hash()}")
    for seed in SEEDS[:1]:
        blind, seeing = trace(subject, seed), trace(subject, seed, look=True)
        if (blind.end, blind.exact_end) != (seeing.end, seeing.exact_end):
            yield Fault(f"seed {seed} to end alike whether or not anyone looks", f"{blind.end}, looking {seeing.end}")


@check("seeds-elsewhere", look="what depends on the process: hash order, addresses, time, warm caches")
def seeds_elsewhere(subject: Subject) -> Iterator[Fault]:
    """An equal seed gives an equal episode in another process."""
    seed = SEEDS[2]
    subject.simulation.reset(0, CLEAN)
    told = ask_elsewhere(subject.task, subject.view, {"trace": seed})
    answer = Trace(**{**told, "looks": tuple(told["looks"])})
    here = trace(subject, seed)
    if answer != here:
        parts = [
            name for name in ("start", "end", "exact_end", "looks") if getattr(answer, name) != getattr(here, name)
        ]
        yield Fault(f"seed {seed} to be the same in another process", f"others: {', '.join(parts)}")


@check("two-at-once", look="what simulations of a process share: a client, a scene, a renderer, module state")
def two_at_once(subject: Subject) -> Iterator[Fault]:
    """Two simulations of the task in one process do not touch each other."""
    alone = trace(subject, 0)
    with subject.another() as other:
        other.reset(1, CLEAN)
        simulation = subject.reset(0)
        for mine, theirs in zip(subject.random_actions(0, STEPS), subject.random_actions(7, STEPS), strict=True):
            simulation.step(mine)
            other.step(theirs)
        if simulation.state_hash() != alone.end:
            yield Fault("the same end beside another simulation", f"{alone.end}, then {simulation.state_hash()}")
    if (after := trace(subject, 0)) != alone:
        yield Fault("the same episode after the other was closed", f"{alone.end}, then {after.end}")


CHECKS = (seeds, seeds_images, looking, seeds_elsewhere, two_at_once)
