"""The additions of RoboGauntlet's client and server to openpi's protocol, in keys that others ignore.

A policy behind RoboGauntlet's server gets the same input as in the process: the episode that keys its randomness, the
step and, for oracles, the true state. The answer includes the routing evidence.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from robogauntlet.adapters.contract import ACTION_DIM, Body, Moves, Observation
from robogauntlet.policies.contract import Decision, Policy, PolicyInput, PolicySpec, Query, Routing, StatelessPolicy
from robogauntlet.policies.remote.msgpack_numpy import PackingError
from robogauntlet.policies.remote.server_options import ACTIONS_KEY, CAMERA_KEYS, INSTRUCTION_KEY, STATE_KEY
from robogauntlet.policies.stored import first_fault
from robogauntlet.suites.episode import Episode

VERSION = 1
EPISODE, STEP, FINISHED, TRUE_STATE, ROUTING, OF_JOINTS, NATIVE = (
    f"robogauntlet/{name}"
    for name in ("episode", "step", "finished", "privileged_state", "routing", "of_joints", "native")
)
UNITS = "metres, radians (axis-angle), gripper -1 open to +1 closed; robot base frame"
JOINT_UNITS = {False: "targets of joints in radians", True: "velocities of joints in radians per second"}
GRIPPER_UNITS = "gripper -1 open to +1 closed"
MOST_NUMBERS, MOST_NATIVE = 64, 10_000
"""Of an observation's proprioception: of a robot, and of the environment's own."""


@dataclass(frozen=True)
class Keys:
    """Where a protocol's message has the parts of an observation."""

    cameras: Mapping[str, str]
    """Camera to key."""
    state: str
    instruction: str


OPENPI = Keys(CAMERA_KEYS, STATE_KEY, INSTRUCTION_KEY)
_EPISODE, _ROUTING = TypeAdapter(Episode), TypeAdapter(Routing)


@dataclass(frozen=True)
class Greeting:
    """A RoboGauntlet server's description of its policy, sent on connection."""

    digest: str
    spec: PolicySpec
    remembers: bool
    """Whether the policy keeps state of an episode between queries, which is lost with the connection."""


_GREETING = TypeAdapter(Greeting)
MAX_IMAGE_SIZE, MAX_CHUNK = 1024, 1_000_000
"""What a server's greeting may ask for: height and width (px) of images, actions in a chunk."""
LONGEST_INSTRUCTION = 1000
"""Characters of an instruction that a client may send: a network's memory grows with the square of its words."""
_DIGEST = re.compile(r"[!-~]{1,200}")


def greeting_of(policy: Policy, digest: str) -> Greeting:
    """Return the greeting of a policy's server."""
    forgets = isinstance(policy, StatelessPolicy) and type(policy).finish is StatelessPolicy.finish
    return Greeting(digest, policy.spec, remembers=not forgets)


def as_metadata(greeting: Greeting) -> dict[str, Any]:
    """Return the metadata frame, which other clients can read; RoboGauntlet's client reads its part `robogauntlet`."""
    spec = greeting.spec
    body = _body(spec)
    units = f"{JOINT_UNITS[body.velocities]}, {GRIPPER_UNITS}" if body.joints else UNITS
    return {
        "action_dim": body.action_dim,
        "action_horizon": spec.chunk_length,
        "action_names": list(body.action_names),
        "action_units": str(Moves.NATIVE) if body.native else units,
        "cameras": {camera: CAMERA_KEYS[camera] for camera in spec.cameras},
        "image_size": spec.image_size,
        "state_dim": body.proprioception_dim,
        "robogauntlet": {"version": VERSION, **_GREETING.dump_python(greeting, mode="json")},
    }


def greeting_in(metadata: Mapping[str, Any]) -> Greeting | None:
    """Return the greeting of a RoboGauntlet server, PackingError if of another version; None for other servers."""
    greeting = metadata.get("robogauntlet")
    if not isinstance(greeting, Mapping):
        return None
    if greeting.get("version") != VERSION:
        version = str(greeting.get("version"))[:20]
        raise PackingError(f"expected a RoboGauntlet server of version {VERSION}, got version {version}")
    try:
        found = _GREETING.validate_python(dict(greeting))
    except ValidationError as error:
        raise PackingError(f"expected the policy's needs, got something else: {first_fault(error)}") from None
    spec = found.spec
    if not _DIGEST.fullmatch(found.digest):
        raise PackingError(f"expected the policy's hash, got {found.digest[:40]!a}")
    if not 1 <= spec.chunk_length <= MAX_CHUNK or not 1 <= (spec.image_size or 1) <= MAX_IMAGE_SIZE:
        size = f"chunks of {spec.chunk_length} actions and images of {spec.image_size} px"
        raise PackingError(
            f"expected chunks of {MAX_CHUNK} actions and images of {MAX_IMAGE_SIZE} px at most, got {size}"
        )
    if not set(spec.cameras) <= set(CAMERA_KEYS):
        raise PackingError(f"expected cameras among {', '.join(CAMERA_KEYS)}, got others")
    return found


def as_message(query: Query, finished: Sequence[str]) -> dict[str, Any]:
    """Return a query's message to a RoboGauntlet server, with the ids of `finished` episodes that it may forget."""
    message: dict[str, Any] = {EPISODE: asdict(query.episode), STEP: query.step}
    if finished:
        message[FINISHED] = list(finished)
    if query.observation is not None:
        observation = query.observation
        message |= {CAMERA_KEYS[camera]: image for camera, image in observation.images.items()}
        message |= {STATE_KEY: observation.proprioception, INSTRUCTION_KEY: observation.instruction}
        if observation.of_joints:
            message[OF_JOINTS] = True
        if observation.native is not None:
            message[NATIVE] = observation.native
    if query.privileged_state is not None:
        message[TRUE_STATE] = dict(query.privileged_state)
    return message


def episode_in(message: Mapping[str, Any]) -> tuple[Episode, int] | None:
    """Return episode and step of a message, PackingError if malformed; None if its client is not RoboGauntlet's."""
    if EPISODE not in message:
        return None
    step = message.get(STEP)
    if type(step) is not int or not 0 <= step < 2**31:
        raise PackingError(f"expected a number of steps as {STEP}, got {str(step)[:40]}")
    try:
        return _EPISODE.validate_python(message[EPISODE]), step
    except ValidationError as error:
        raise PackingError(f"expected an episode as {EPISODE}: {first_fault(error)}") from None


def finished_in(message: Mapping[str, Any]) -> list[str]:
    """Return the ids of the episodes that the client has finished."""
    finished = message.get(FINISHED, [])
    return [name for name in finished if isinstance(name, str)] if isinstance(finished, list) else []


def query_in(message: Mapping[str, Any], episode: Episode, step: int, spec: PolicySpec, keys: Keys = OPENPI) -> Query:
    """Return a message as a policy's query. Raises PackingError if an input of the policy is missing or malformed."""
    match spec.sees:
        case PolicyInput.OBSERVATION:
            return Query(episode, step, observation=_observation(message, spec, keys))
        case PolicyInput.PRIVILEGED_STATE:
            state = message.get(TRUE_STATE)
            if not isinstance(state, dict) or not all(isinstance(value, np.ndarray) for value in state.values()):
                raise PackingError(f"expected {TRUE_STATE}, on which this policy acts, got none")
            return Query(episode, step, privileged_state=state)
        case PolicyInput.NOTHING:
            return Query(episode, step)


def _observation(message: Mapping[str, Any], spec: PolicySpec, keys: Keys) -> Observation:
    cameras = {key: camera for camera, key in keys.cameras.items()}
    # The message's order is that of the view.
    images = {cameras[key]: _image(key, value, spec) for key, value in message.items() if key in cameras}
    missing = [camera for camera in spec.cameras if camera not in images]
    if missing or not images:
        needed = keys.cameras[missing[0]] if missing else " or ".join(keys.cameras.values())
        given = ", ".join(sorted(map(str, message)))[:200]
        raise PackingError(f"expected an image as {needed}, got none among {given}")
    state = message.get(keys.state)
    native = message.get(NATIVE, spec.action_dim if spec.moves is Moves.NATIVE else None)
    if native is not None and (type(native) is not int or not 1 <= native <= MOST_NATIVE):
        raise PackingError(f"expected 1 to {MOST_NATIVE} numbers of an action as {NATIVE}, got {str(native)[:40]}")
    of_joints = message.get(OF_JOINTS) is True or bool(_body(spec).joints)
    sizes: Sequence[int] = range(2, MOST_NUMBERS + 1)
    if native is not None:
        sizes = range(MOST_NATIVE + 1)
    elif spec.action_dim is not None:
        sizes = [spec.action_dim if of_joints else _body(spec).proprioception_dim]
    elif not of_joints:
        sizes = [Body(arms).proprioception_dim for arms in (1, 2)]
    if not isinstance(state, np.ndarray) or state.dtype.kind not in "iuf" or state.shape not in [(n,) for n in sizes]:
        got = f"shape {state.shape}" if isinstance(state, np.ndarray) else f"a {type(state).__name__}"
        wanted = f"{sizes[0]} to {sizes[-1]}" if isinstance(sizes, range) else " or ".join(map(str, sizes))
        raise PackingError(f"expected an array of {wanted} numbers as {keys.state}, got {got}")
    instruction = message.get(keys.instruction, "")
    if isinstance(instruction, np.ndarray) and instruction.ndim == 0:
        instruction = instruction.item()
    if not isinstance(instruction, str):
        raise PackingError(f"expected text as {keys.instruction}, got {type(instruction).__name__}")
    if len(instruction) > LONGEST_INSTRUCTION:
        expected = f"expected at most {LONGEST_INSTRUCTION} characters as {keys.instruction}"
        raise PackingError(f"{expected}, got {len(instruction)}")
    return Observation(images, state.astype(np.float64), str(instruction), of_joints and native is None, native)


def _body(spec: PolicySpec) -> Body:
    """Return the body of as many numbers; of another number than that of tools, or by `moves`, it has joints."""
    numbers = ACTION_DIM if spec.action_dim is None else spec.action_dim
    if spec.moves is Moves.NATIVE:
        return Body(native=tuple(f"number_{number}" for number in range(1, numbers + 1)))
    if numbers in (ACTION_DIM, 2 * ACTION_DIM) and spec.moves in (None, Moves.TOOL):
        return Body(numbers // ACTION_DIM)
    joints = tuple(f"joint_{number}" for number in range(1, numbers))
    return Body(joints=joints, velocities=spec.moves is Moves.VELOCITIES)


def _image(key: str, value: Any, spec: PolicySpec) -> np.ndarray:
    size = spec.image_size
    expected = f"({size or 'height'}, {size or 'width'}, 3)"
    if not isinstance(value, np.ndarray) or value.dtype != np.uint8:
        got = f"type {value.dtype}" if isinstance(value, np.ndarray) else f"a {type(value).__name__}"
        raise PackingError(f"expected an image of bytes, shape {expected}, as {key}, got {got}")
    if value.ndim != 3 or value.shape[2] != 3 or 0 in value.shape or (size and value.shape[:2] != (size, size)):
        raise PackingError(f"expected an image of shape {expected} as {key}, got {value.shape}")
    return value


def as_answer(decision: Decision) -> dict[str, Any]:
    """Return a decision as the server sends it."""
    answer: dict[str, Any] = {ACTIONS_KEY: decision.actions}
    if decision.routing is not None:
        answer[ROUTING] = _ROUTING.dump_python(decision.routing, mode="json")
    return answer


def routing_in(message: Mapping[str, Any]) -> Routing | None:
    """Return the routing evidence of an answer, PackingError if malformed; None without."""
    if ROUTING not in message:
        return None
    try:
        return _ROUTING.validate_python(message[ROUTING])
    except ValidationError as error:
        raise PackingError(f"expected routing evidence as {ROUTING}: {first_fault(error)}") from None
