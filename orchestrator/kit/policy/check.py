"""Plays short episodes of a policy and says what its numbers do."""

from __future__ import annotations

import base64
import os
import sys
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from robogauntlet.adapters import catalog as simulators
from robogauntlet.adapters.contract import AdapterError, FloatArray, Image, Moves, Simulation, SimulatorUnavailable
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.orchestrator.inference.planned_policy import LOADING_S
from robogauntlet.orchestrator.kit.finding import Finding, Level
from robogauntlet.orchestrator.kit.policy import actions, joints, motion, observation, repetition
from robogauntlet.orchestrator.kit.policy.picture import draw_picture
from robogauntlet.orchestrator.kit.policy.recording import InvalidAnswer, Play, play
from robogauntlet.orchestrator.kit.process import CheckProcess
from robogauntlet.policies import catalog
from robogauntlet.policies.contract import (
    Policy,
    PolicyError,
    PolicyInput,
    PolicyMismatch,
    PolicySpec,
    Query,
    Wishes,
    check_fit,
    check_tasks,
)
from robogauntlet.policies.remote.conversion import EncodesImages
from robogauntlet.suites.episode import CAMERAS, Episode, Protocol, View
from robogauntlet.support.child_process import ChildEnded, ChildTimeout
from robogauntlet.support.secret_variables import playing_variables

ENDED = "the policy ended its process"
DAY_S = 86_400.0
"""No limit for a check in all: each answer of the policy has its own."""
STEPS = 40
"""Control steps of an episode, unless the task's horizon is shorter."""
IMAGE_SIZE = View().image_size
REPLAN_EVERY = Protocol(STEPS).replan_every
GIVEN = {
    PolicyInput.NOTHING: "nothing of the scene: no images, no state",
    PolicyInput.PRIVILEGED_STATE: "the true state instead of images",
}


@dataclass(frozen=True)
class Probe:
    """A policy and the task on which it is checked."""

    name: str
    source: PolicySource
    task: str
    """`simulator/task`."""
    seed: int = 0
    image_size: int | None = None
    """Height and width of frames (px); None for what the policy asks for, or else that of a suite."""


def as_plain(found: Finding | Image) -> dict[str, Any]:
    """Return a finding, or the picture, as values of JSON."""
    if isinstance(found, Finding):
        return asdict(found)
    return {"shape": found.shape, "pixels": base64.b64encode(found.tobytes()).decode()}


def from_plain(plain: Mapping[str, Any]) -> Finding | Image:
    """Return what `as_plain` has written."""
    if "pixels" in plain:
        return np.frombuffer(base64.b64decode(plain["pixels"]), np.uint8).reshape(plain["shape"])
    return Finding.from_plain(plain)


def check_policy(probe: Probe) -> Iterator[Finding | Image]:
    """Play the policy in a process of its own, and yield findings and at last their picture, if it was played.

    Threads, another working directory or a crash of the policy stay in the process.

    Raises:
        PolicyError: The policy cannot be loaded, or cannot act in the task.
        AdapterError: The task cannot be opened.
    """
    try:
        yield from map(from_plain, _ask_apart(probe, "check"))
    except ChildEnded:
        yield Finding("answer", Level.FAILED, ENDED)


def _ask_apart(probe: Probe, request: str) -> Any:
    """Return what `child.py` answers to a request, and print what it printed to standard error.

    Raises:
        ChildEnded: The process ended before it answered.
        PolicyError: The policy was not built within `LOADING_S`, or its process says why it cannot be checked.
        AdapterError: The task cannot be opened.
    """
    simulator, source = simulators.find(probe.task.partition("/")[0]), probe.source
    environments = EnvironmentResolver()
    has_own = environments.resolve(simulator) is not None
    if has_own and (reason := environments.missing_reason(simulator)):
        raise SimulatorUnavailable(f"{simulator.name}: {reason}")
    plain = {**vars(probe), "source": {"kind": source.kind, "options": source.options, "digest": source.digest}}
    building = {"probe": plain, "path": None if has_own else sys.path}
    variables = {**playing_variables(os.environ), **(source.variables or {})}
    process = CheckProcess(probe.task, "policy.child", variables=variables)
    try:
        for asked, limit_s in ((building, LOADING_S), (request, DAY_S)):
            answer = process.ask(asked, limit_s)
            if "error" in answer:
                raise (AdapterError if answer["of_adapter"] else PolicyError)(answer["error"])
    except ChildTimeout:
        text = f"expected the policy to be built within {LOADING_S:g} s, got none; find out where it hangs"
        raise PolicyError(text) from None
    finally:
        sys.stderr.write(process.stderr)
        process.close()
    return answer["answer"]


def findings_of(policy: Policy, probe: Probe) -> Iterator[Finding | Image]:
    """Play a policy that is built; see `check_policy`."""
    if simulators.body_of(probe.task).arms != 1:
        raise PolicyError(f"expected a task of one arm, to check a policy; {probe.task} has two arms")
    try:
        check_tasks(policy.spec, [probe.task])
    except PolicyMismatch as error:
        raise PolicyMismatch(f"policy '{probe.name}' does not fit: {error}") from None
    simulation = simulators.open_simulation(probe.task, _view(probe, policy.spec))
    try:
        yield from _Check(probe, policy, simulation).findings()
    except InvalidAnswer as error:
        yield Finding("answer", Level.FAILED, str(error))
    except PolicyMismatch as error:
        yield Finding("fit", Level.FAILED, str(error))
    finally:
        simulation.close()


def _view(probe: Probe, spec: PolicySpec) -> View:
    simulator, _, name = probe.task.partition("/")
    tasks = simulators.find(simulator).tasks
    offered = tasks[name].cameras if name in tasks else CAMERAS
    size = spec.image_size or probe.image_size or _wishes(probe).image_size or IMAGE_SIZE
    return View(tuple(camera for camera in CAMERAS if camera in offered), size)


def _wishes(probe: Probe) -> Wishes:
    return catalog.wishes(probe.source.kind, probe.source.options)


def _afresh(probe: Probe) -> FloatArray:
    """Play the first episode where nothing is left of another one, not even in the policy's modules."""
    try:
        return np.array(_ask_apart(probe, "play"))
    except ChildEnded:
        raise InvalidAnswer(ENDED) from None


def first_actions(policy: Policy, probe: Probe) -> FloatArray:
    """Play the first episode and return its actions. Raises as `recording.play`."""
    simulation = simulators.open_simulation(probe.task, _view(probe, policy.spec))
    try:
        return play(simulation, policy, _Check(probe, policy, simulation).episode(0)).actions()
    finally:
        simulation.close()


class _Check:
    def __init__(self, probe: Probe, policy: Policy, simulation: Simulation) -> None:
        self._probe, self._policy, self._simulation = probe, policy, simulation

    def findings(self) -> Iterator[Finding | Image]:
        probe, policy, simulation = self._probe, self._policy, self._simulation
        check_fit(policy.spec, simulation.action_spec, simulation.observation_spec)
        first, other, again = (play(simulation, policy, self.episode(seed)) for seed in (0, 1, 0))
        plays, spec = [first, other], simulation.action_spec
        executed = np.concatenate([played.actions() for played in plays])
        replan_every = first.episode.protocol.replan_every
        yield from actions.answers([first, other, again], replan_every)
        limits = {Moves.TOOL: actions.limits, Moves.TARGETS: joints.targets, Moves.VELOCITIES: joints.velocities}
        limits[Moves.NATIVE], moves = actions.native, list[motion.Movement]()
        yield from limits[spec.body.moves](plays, spec)
        if not spec.numbers:
            moves += motion.movements(simulation, plays)
            yield from motion.components(simulation, executed, moves)
            yield from actions.gripper(plays, spec)
            yield from motion.fingers(simulation, probe.seed)
            yield from motion.whole(first)
        shown = [] if policy.spec.sees is not PolicyInput.OBSERVATION else self._images(first)
        if shown:
            yield _sent(shown[0][1])
            yield from _enlarged(simulation.observation_spec.image_size, _wishes(probe).image_size)
            yield from observation.sensitivity(policy, first.answers)
        else:
            yield Finding("input", Level.NOTE, f"the policy gets {GIVEN[policy.spec.sees]}")
        yield from repetition.repeated(first, again, lambda: _afresh(probe))
        title = f"{probe.name} in {probe.task}: the images as the policy gets them, and its actions (red: limits)"
        yield draw_picture(shown, first.actions(), spec, moves, title)

    def episode(self, number: int) -> Episode:
        probe, spec = self._probe, self._simulation.observation_spec
        simulator, _, name = probe.task.partition("/")
        horizon = min(STEPS, simulators.find(simulator).tasks[name].horizon)
        view = View(spec.cameras, spec.image_size)
        protocol = Protocol(horizon, max(REPLAN_EVERY, _wishes(probe).execute or 0), view)
        return Episode(probe.name, probe.source.digest or "", probe.task, probe.seed + number, protocol)

    def _images(self, played: Play) -> list[tuple[str, Mapping[str, Image]]]:
        """Label and images, as the policy gets them, of the first and the last query."""
        queries = list(dict.fromkeys((0, len(played.answers) - 1)))
        chosen = [(number, played.answers[number].query) for number in queries]
        return [(f"query {number + 1}/step {query.step}", self._as_sent(query)) for number, query in chosen]

    def _as_sent(self, query: Query) -> Mapping[str, Image]:
        if isinstance(self._policy, EncodesImages):
            return self._policy.images_sent(query)
        assert query.observation is not None
        return query.observation.images


def _enlarged(rendered: int, asked: int | None) -> Iterator[Finding]:
    if asked is not None and asked > rendered:
        text = f"frames are rendered at {rendered} px and enlarged to {asked}; leave --image-size out"
        yield Finding("images", Level.WARNING, text, {"rendered_px": float(rendered), "asked_px": float(asked)})


def _sent(images: Mapping[str, Image]) -> Finding:
    sizes = ", ".join(f"{name} {image.shape[0]} x {image.shape[1]}" for name, image in images.items())
    numbers = {f"{name}_height_px": float(image.shape[0]) for name, image in images.items()}
    return Finding(
        "images", Level.NOTE, f"{sizes}, as in the picture: compare them with those of the training", numbers
    )
