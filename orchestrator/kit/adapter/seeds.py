"""Equal seeds give equal episodes: after any other episodes, with or without observations, in any process."""

from __future__ import annotations

import hashlib
import random
from collections.abc import Iterator
from contextlib import closing
from dataclasses import asdict, dataclass

import numpy as np

from robogauntlet.adapters.contract import Observation
from robogauntlet.orchestrator.kit.adapter.check import Violation, check, expect
from robogauntlet.orchestrator.kit.adapter.checked_task import CheckedTask
from robogauntlet.orchestrator.kit.adapter.runner import ask_new_process

SEEDS = range(4)
STEPS = 40
OBSERVE_EVERY = 8


@dataclass(frozen=True)
class Trace:
    """State hashes at the start and at the end of an episode with fixed actions, and hashes of its observations."""

    start: str
    end: str
    exact_end: str
    """All bytes of the privileged state after the last step."""
    observations: tuple[str, ...] = ()


def trace(subject: CheckedTask, seed: int, *, observe: bool = False) -> Trace:
    """Play an episode with actions drawn from its seed, and observe every few steps if `observe`."""
    simulation = subject.simulation
    random.seed()  # an adapter that reads a global generator is revealed, because their states differ each time
    np.random.seed(None)
    np.random.random(seed + 1)
    simulation.reset(seed)
    start, observations = simulation.state_hash(), []
    for number, action in enumerate(subject.random_actions(seed, STEPS)):
        if observe and number % OBSERVE_EVERY == 0:
            observations.append(digest(simulation.observe()))
        if simulation.step(action).terminated:
            break
    state = simulation.privileged_state()
    exact_end = b"".join(np.asarray(state[name], np.float64).tobytes() for name in sorted(state)).hex()
    return Trace(start, simulation.state_hash(), exact_end, tuple(observations))


def digest(observation: Observation) -> str:
    """Hash of all bytes of an observation."""
    sha = hashlib.sha256(observation.proprioception.tobytes())
    for camera in sorted(observation.images):
        sha.update(camera.encode() + np.ascontiguousarray(observation.images[camera]).tobytes())
    return sha.hexdigest()[:16]


@check("seeds", look="Simulation.reset: generators, contact caches, solver and controller memory")
def seeds(subject: CheckedTask) -> Iterator[Violation]:
    """An equal seed gives a bit-identical episode, whatever was played before."""
    forwards = {seed: trace(subject, seed) for seed in SEEDS}
    backwards = {seed: trace(subject, seed) for seed in reversed(SEEDS)}
    for seed in SEEDS:
        first, second = forwards[seed], backwards[seed]
        if first.start != second.start:
            expected = f"seed {seed} to start alike after other episodes"
            yield Violation(expected, f"state hash {first.start}, then {second.start}")
        elif first != second:
            bits = ", which differ in the last bits only" if first.end == second.end else ""
            expected = f"seed {seed} to end alike after the same {STEPS} actions"
            yield Violation(expected, f"state hash {first.end}, then {second.end}{bits}")
    states = subject.description.start_states
    yield from expect(states is None or states >= 1, "start_states to be None, or 1 or more", states)
    starts, several = len({trace.start for trace in forwards.values()}), min(states or len(SEEDS), len(SEEDS))
    yield from expect(starts >= several, "other seeds to start differently", f"{starts} of {several}")


@check(
    "seeds-images", look="parts of the image that are not in the state: lights, textures, cameras, caches", renders=True
)
def seeds_images(subject: CheckedTask) -> Iterator[Violation]:
    """An equal seed gives bit-identical images, whatever was played and observed before."""
    first = {seed: digest(subject.reset(seed).observe()) for seed in SEEDS[:2]}
    for seed in reversed(SEEDS[:2]):
        same = digest(subject.reset(seed).observe()) == first[seed]
        yield from expect(same, f"the images of seed {seed} again", "others")


@check("observing", look="Simulation.observe: it must not step, settle, or write to the simulation")
def observing(subject: CheckedTask) -> Iterator[Violation]:
    """An observation does not change what follows."""
    simulation = subject.reset(1)
    before = simulation.state_hash()
    simulation.observe()
    after = simulation.state_hash()
    yield from expect(after == before, "the same state before and after an observation", f"{before}, then {after}")
    seed = SEEDS[0]
    unseen, seen = trace(subject, seed), trace(subject, seed, observe=True)
    same = (unseen.end, unseen.exact_end) == (seen.end, seen.exact_end)
    expected = f"seed {seed} to end alike with and without observations"
    yield from expect(same, expected, f"{unseen.end}, observing {seen.end}")


@check("seeds-new-process", look="values that depend on the process: hash order, addresses, time, warm caches")
def seeds_new_process(subject: CheckedTask) -> Iterator[Violation]:
    """An equal seed gives an equal episode in another process."""
    seed = SEEDS[2]
    subject.simulation.reset(0)
    answer = ask_new_process(subject.task, {"trace": seed})
    own = asdict(trace(subject, seed))
    parts = [name for name in ("start", "end", "exact_end") if answer[name] != own[name]]
    yield from expect(not parts, f"seed {seed} to be the same in another process", f"others: {', '.join(parts)}")


@check("two-at-once", look="state that simulations of a process share: a client, a scene, a renderer, module variables")
def two_at_once(subject: CheckedTask) -> Iterator[Violation]:
    """Two simulations of the task in one process do not affect each other."""
    alone = trace(subject, 0)
    with closing(subject.open()) as other:
        other.reset(1)
        simulation = subject.reset(0)
        for mine, theirs in zip(subject.random_actions(0, STEPS), subject.random_actions(7, STEPS), strict=True):
            if simulation.step(mine).terminated or other.step(theirs).terminated:
                break
        end = simulation.state_hash()
        yield from expect(end == alone.end, "the same end beside another simulation", f"{alone.end}, then {end}")
    after = trace(subject, 0)
    yield from expect(after == alone, "the same episode after the other was closed", f"{alone.end}, then {after.end}")


CHECKS = (seeds, seeds_images, observing, seeds_new_process, two_at_once)
