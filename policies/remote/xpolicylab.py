"""A policy behind a policy server of XPolicyLab.

The contract is that of https://github.com/XPolicyLab/XPolicyLab (`client_server/ws`, "Observation Data Format v1.0"):
messages `{message_type, message_id, evaluation_id, trial_id, step, payload, ...}` as msgpack, arrays as msgpack-numpy
writes them. The client says hello, a trial begins with a reset, and each observation is answered with a list of
actions, mappings of arrays. The server has one model, whose state is that of one trial.
"""

from __future__ import annotations

import contextlib
import uuid
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from robogauntlet.adapters.contract import Image
from robogauntlet.policies.contract import Decision, PolicyError, PolicyInput, PolicyMismatch, PolicySpec, Query
from robogauntlet.policies.remote.connection import error_text, packed
from robogauntlet.policies.remote.conversion import MAX_ACTIONS, decode_chunk, encode_images, encode_proprioception
from robogauntlet.policies.remote.msgpack_numpy import PackingError, nd_array, nd_message
from robogauntlet.policies.remote.remote_policy import ConnectionLost, WebsocketPolicy
from robogauntlet.policies.remote.server_options import ChunkKeys, Key, ServerOptions, StateKeys
from robogauntlet.suites.episode import CAMERAS, Episode
from robogauntlet.support.text import visible

ARM, GRIPPER, DISPLACEMENT = "arm_joint_state", "ee_joint_state", "delta_ee_pose"
"""Keys of an action: targets of joints, the gripper, and the tool's displacement, a place and a quaternion."""
POSES = ("ee_pose", "tcp_pose")
"""Keys of an action that is where the tool shall be."""
ANSWERS = {"hello": "hello_ack", "reset": "reset_result", "infer": "infer_result", "trial_end": "trial_end_ack"}
"""Type of a question to that of its answer."""


class XPolicyLabOptions(ServerOptions):
    """The options of the kind `xpolicylab`."""

    PROTOCOL: ClassVar[str] = "xpolicylab"
    FORM: ClassVar[str] = "xpolicylab://HOST:PORT"
    ASKS_UNITS: ClassVar[bool] = True

    address: str
    """xpolicylab://HOST:PORT, or ws:// or wss://"""
    cameras: dict[str, Key] = Field(default=dict(zip(CAMERAS, ("cam_head", "cam_wrist"), strict=True)))
    """camera to its name in vision"""
    proprioception: StateKeys = None
    """keys of state, each with the columns that it gets; by default arm_joint_state and ee_joint_state with joints,
    else none"""
    instruction: Key | None = "instruction"
    """key of the goal in words; null to leave it out"""
    actions: ChunkKeys = (DISPLACEMENT, GRIPPER)
    """keys of an action whose numbers are put side by side; by default arm_joint_state and ee_joint_state with joints,
    else delta_ee_pose and ee_joint_state"""

    def _keys_beside_each_other(self) -> list[list[str]]:
        return [[*self.cameras.values()]]


def frame_of(kind: str, payload: Mapping[str, Any], trial: str | None = None, step: int = 0) -> bytes:
    """Return a question as bytes. Raises PolicyError if it cannot be sent."""
    return packed(
        {
            "message_type": kind,
            "message_id": uuid.uuid4().hex,
            "evaluation_id": "robogauntlet",
            "action_case_id": None,
            "trial_id": trial,
            "repeat_index": None,
            "step": step,
            "sent_at": datetime.now(UTC).isoformat(),
            "payload": dict(payload),
        }
    )


def fitted(options: ServerOptions) -> ServerOptions:
    """Return the options with the keys that are not given. Raises PolicyMismatch if an option is missing or a pose."""
    if missing := options.unsaid():
        raise PolicyMismatch(
            f"its actions do not say {', '.join(missing)}; give each by an option, or all by option convention"
        )
    given, found = options.model_fields_set, {}
    if options.has_joints and options.arms == 1:
        last = options.width - 1
        found = {"actions": (ARM, GRIPPER), "proprioception": {ARM: tuple(range(last)), GRIPPER: (last,)}}
    options = options.model_copy(update={name: value for name, value in found.items() if name not in given})
    keys = [options.actions] if isinstance(options.actions, str) else options.actions
    if poses := [key for key in keys if _is_pose(key)]:
        raise PolicyMismatch(
            f"option actions: expected displacements or targets of joints, got {poses[0]}, which is a pose"
        )
    return options


def _is_pose(key: str) -> bool:
    return key.endswith(POSES) and not key.endswith(DISPLACEMENT)


def chunks_in(actions: Any, keys: ChunkKeys) -> dict[str, np.ndarray]:
    """Return an answer's actions as a chunk (n, columns) of each key. Raises PolicyMismatch or PackingError."""
    steps = [actions] if isinstance(actions, dict) and b"nd" not in actions else actions
    if not isinstance(steps, list) or not steps or not all(isinstance(step, dict) for step in steps):
        raise PolicyMismatch(f"expected a list of actions, mappings of arrays, got {type(actions).__name__}")
    wanted = [keys] if isinstance(keys, str) else keys
    for step in steps:
        if missing := [key for key in wanted if key not in step]:
            named = sorted(map(str, step))
            got = visible(", ".join(named)[:200]) or "nothing"
            hint = "poses are not played: serve it with action_type joint"
            hint = hint if any(map(_is_pose, named)) else "set option actions"
            raise PolicyMismatch(f"expected '{missing[0]}' in an action, got {got}; {hint}")
    try:
        return {key: np.stack([np.ravel(nd_array(step[key])) for step in steps]) for key in wanted}
    except ValueError:
        raise PolicyMismatch("expected actions of one size, got several") from None


class XPolicyLabPolicy(WebsocketPolicy):
    """Asks a policy server of XPolicyLab, one episode at a time. Deterministic if the server is."""

    expected = "the hello_ack of a policy server of XPolicyLab"

    def __init__(self, options: ServerOptions) -> None:
        """Connect, unless `options.identity` names the policy."""
        try:
            self._fitted = fitted(options)
        except PolicyMismatch as error:
            raise PolicyMismatch(f"policy server {options.address}: {error}") from None
        self._trial: tuple[str, int] | None = None
        """The episode that the server plays, and the number of its connection."""
        self.hello = frame_of("hello", {})
        super().__init__(options)
        execute = options.execute or MAX_ACTIONS
        self.spec = PolicySpec(
            PolicyInput.OBSERVATION, execute, options.action_dim, tuple(options.cameras), moves=options.moves
        )

    def reset(self, episodes: Sequence[Episode]) -> None:
        """Start these episodes; the server is told with the first query of each."""

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """Ask the server each query.

        Raises:
            PolicyError: See `ServerConnection.ask`; or the answer does not fit the options.
            ConnectionLost: The connection was lost within the episode, and with it the model's state.
        """
        return [self._decide(query) for query in queries]

    def finish(self, episodes: Sequence[Episode]) -> None:
        """End these episodes."""
        for episode in episodes:
            if self._trial is not None and self._trial[0] == episode.id:
                with contextlib.suppress(PolicyError, ConnectionLost):  # its actions are executed already
                    self._ask("trial_end", {"trial_id": episode.id}, episode.id)
                self._trial = None

    def images_sent(self, query: Query) -> Mapping[str, Image]:
        """Return the images of a query as the server gets them, by their names in vision."""
        assert query.observation is not None
        return encode_images(self._fitted, query.observation, query.episode)

    def _read_metadata(self, message: Mapping[str, Any]) -> Mapping[str, Any]:
        self._payload("hello", message)
        return {}  # it names its process, not its model

    def _decide(self, query: Query) -> Decision:
        episode = query.episode.id
        if query.step == 0 or self._trial is None:
            self._trial = None
            self._ask("reset", {"trial_id": episode}, episode)
            self._trial = (episode, self._connection.number)
        elif self._trial[0] != episode:
            raise PolicyError(
                f"{self._server}: expected one episode at a time, since the server has one model, got several; "
                "leave inference: worker"
            )
        payload = self._ask("infer", {"observation": self._observation(query)}, episode, query.step)
        try:
            chunks = chunks_in(payload.get("actions"), self._fitted.actions)
            return Decision(decode_chunk(self._fitted, chunks, query.action_dim))
        except (PackingError, PolicyMismatch) as error:
            raise PolicyMismatch(f"{self._server}: {error}") from None

    def _ask(self, kind: str, payload: Mapping[str, Any], trial: str, step: int = 0) -> Mapping[str, Any]:
        """Return the payload of the answer. Raises ConnectionLost if the trial was that of another connection."""

        def frames() -> list[bytes]:
            if self._trial is not None and self._trial[1] != self._connection.number:
                self._trial = None
                raise ConnectionLost(f"{self._server} was lost during the episode")
            return [frame_of(kind, payload, trial, step)]

        return self._payload(kind, self._connection.ask(frames))

    def _payload(self, kind: str, message: Mapping[str, Any]) -> Mapping[str, Any]:
        found, payload = message.get("message_type"), message.get("payload")
        if found == "error":
            text = payload.get("message") if isinstance(payload, dict) else payload
            raise PolicyError(f"{self._server}: expected an answer, got an error: {error_text(text)}")
        if found != ANSWERS[kind] or not isinstance(payload, dict):
            shown = visible(f"'{found}' with {type(payload).__name__}")[:100]
            raise PolicyError(f"{self._server}: expected a message '{ANSWERS[kind]}' with a mapping, got {shown}")
        return payload

    def _observation(self, query: Query) -> dict[str, Any]:
        assert query.observation is not None
        seen, options = query.observation, self._fitted
        state = encode_proprioception(options, seen, query.episode)
        observation: dict[str, Any] = {
            "data_format_version": "v1.0",
            "vision": {slot: {"color": nd_message(image)} for slot, image in self.images_sent(query).items()},
        }
        if state:
            observation["state"] = {key: nd_message(part) for key, part in state.items()}
        if options.instruction is not None:
            observation[options.instruction] = seen.instruction
        return observation
