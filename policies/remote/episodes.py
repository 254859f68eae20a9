"""What RoboGauntlet's client and server say to each other beyond openpi's protocol, in keys that others ignore.

With it a policy that is played through a server gets what it would get in the process: the episode that keys its
randomness, the step, and for oracles the true state; and the episode's record gets the routing evidence.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from adapters.contract import ACTION_NAMES, PROPRIOCEPTION_DIM, Observation
from policies.contract import Decision, Policy, PolicySpec, Query, Routing, Sees, StatelessPolicy
from policies.remote.card import ACTIONS_KEY, CAMERA_KEYS, INSTRUCTION_KEY, STATE_KEY, first_fault
from policies.remote.packing import PackingError
from suites.vocabulary import Episode

VERSION = 1
EPISODE, STEP, FINISHED, TRUE_STATE, ROUTING = (
    f"gauntlet/{name}" for name in ("episode", "step", "finished", "privileged_state", "routing")
)
UNITS = "metres, radians (axis-angle), gripper -1 open to +1 closed; robot base frame"

_EPISODE, _ROUTING = TypeAdapter(Episode), TypeAdapter(Routing)


@dataclass(frozen=True)
class Greeting:
    """What RoboGauntlet's server says of its policy on connection."""

    digest: str
    spec: PolicySpec
    remembers: bool
    """Whether it keeps something of an episode between queries, which is lost with the connection."""


_GREETING = TypeAdapter(Greeting)


def greeting_of(policy: Policy, digest: str) -> Greeting:
    """What to say of a policy."""
    return Greeting(digest, policy.spec, not _forgets(policy))


def _forgets(policy: Policy) -> bool:
    own = type(policy)
    return isinstance(policy, StatelessPolicy) and own.finish is StatelessPolicy.finish


def as_metadata(greeting: Greeting) -> dict[str, Any]:
    """The metadata frame: for other clients to read, and under `gauntlet` for ours."""
    spec = greeting.spec
    return {
        "action_dim": spec.action_dim,
        "action_horizon": spec.chunk_length,
        "action_names": list(ACTION_NAMES),
        "action_units": UNITS,
        "cameras": {camera: CAMERA_KEYS[camera] for camera in spec.cameras},
        "image_size": spec.image_size,
        "state_dim": PROPRIOCEPTION_DIM,
        "gauntlet": {"version": VERSION, **_GREETING.dump_python(greeting, mode="json")},
    }


def greeting_in(metadata: Mapping[str, Any]) -> Greeting | None:
    """What RoboGauntlet's server said, or None if it is another's.

    Raises:
        PackingError: It is RoboGauntlet's, of another version.
    """
    said = metadata.get("gauntlet")
    if not isinstance(said, Mapping):
        return None
    if said.get("version") != VERSION:
        version = str(said.get("version"))[:20]
        raise PackingError(f"expected a RoboGauntlet server that speaks version {VERSION}, got version {version}")
    try:
        return _GREETING.validate_python(dict(said))
    except ValidationError as error:
        raise PackingError(f"expected what the policy needs, got something else: {first_fault(error)}") from None


def as_message(query: Query, finished: Sequence[str]) -> dict[str, Any]:
    """A query for RoboGauntlet's server.

    Args:
        query: What is asked.
        finished: Ids of episodes that the server may forget.
    """
    message: dict[str, Any] = {EPISODE: asdict(query.episode), STEP: query.step}
    if finished:
        message[FINISHED] = list(finished)
    if query.observation is not None:
        seen = query.observation
        message |= {CAMERA_KEYS[camera]: image for camera, image in seen.images.items()}
        message |= {STATE_KEY: seen.proprioception, INSTRUCTION_KEY: seen.instruction}
    if query.privileged_state is not None:
        message[TRUE_STATE] = dict(query.privileged_state)
    return message


def episode_in(message: Mapping[str, Any]) -> tuple[Episode, int] | None:
    """Episode and step of a message, or None if its client is not RoboGauntlet's.

    Raises:
        PackingError: They are broken.
    """
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
    """Ids of the episodes that the client says are over."""
    said = message.get(FINISHED, [])
    return [name for name in said if isinstance(name, str)] if isinstance(said, list) else []


def query_in(message: Mapping[str, Any], episode: Episode, step: int, spec: PolicySpec) -> Query:
    """The query that a message is, in the terms of a policy.

    Raises:
        PackingError: Something that the policy looks at is missing, or is not what it should be.
    """
    match spec.sees:
        case Sees.OBSERVATION:
            return Query(episode, step, observation=_observation(message, spec))
        case Sees.PRIVILEGED_STATE:
            state = message.get(TRUE_STATE)
            if not isinstance(state, dict) or not all(isinstance(value, np.ndarray) for value in state.values()):
                raise PackingError(f"expected {TRUE_STATE}: this policy acts on the true state, which is not there")
            return Query(episode, step, privileged_state=state)
        case Sees.NOTHING:
            return Query(episode, step)


def _observation(message: Mapping[str, Any], spec: PolicySpec) -> Observation:
    cameras = {key: camera for camera, key in CAMERA_KEYS.items()}
    # In the order of the message, which is that of the view.
    images = {cameras[key]: _image(key, value, spec) for key, value in message.items() if key in cameras}
    missing = [camera for camera in spec.cameras if camera not in images]
    if missing or not images:
        needed = CAMERA_KEYS[missing[0]] if missing else " or ".join(CAMERA_KEYS.values())
        raise PackingError(f"expected an image as {needed}, got none; there are {', '.join(sorted(map(str, message)))}")
    state = message.get(STATE_KEY)
    if not isinstance(state, np.ndarray) or state.dtype.kind not in "iuf" or state.shape != (PROPRIOCEPTION_DIM,):
        got = f"shape {state.shape}" if isinstance(state, np.ndarray) else f"a {type(state).__name__}"
        raise PackingError(f"expected an array of {PROPRIOCEPTION_DIM} numbers as {STATE_KEY}, got {got}")
    words = message.get(INSTRUCTION_KEY, "")
    if isinstance(words, np.ndarray) and words.ndim == 0:
        words = words.item()
    if not isinstance(words, str):
        raise PackingError(f"expected text as {INSTRUCTION_KEY}, got a {type(words).__name__}")
    return Observation(images, state.astype(np.float64), str(words))


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
    """A decision as the server sends it."""
    answer: dict[str, Any] = {ACTIONS_KEY: decision.actions}
    if decision.routing is not None:
        answer[ROUTING] = _ROUTING.dump_python(decision.routing, mode="json")
    return answer


def routing_in(message: Mapping[str, Any]) -> Routing | None:
    """The routing evidence of an answer, if there is some.

    Raises:
        PackingError: It is broken.
    """
    if ROUTING not in message:
        return None
    try:
        return _ROUTING.validate_python(message[ROUTING])
    except ValidationError as error:
        raise PackingError(f"expected routing evidence as {ROUTING}: {first_fault(error)}") from None
