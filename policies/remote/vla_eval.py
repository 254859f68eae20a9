"""A policy behind a model server of vla-evaluation-harness; the protocol is in `vla_eval_messages`."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from robogauntlet.adapters.contract import Image
from robogauntlet.policies.contract import Decision, PolicyError, PolicyInput, PolicyMismatch, PolicySpec, Query
from robogauntlet.policies.remote.connection import MAX_ERROR_LENGTH, error_text, packed
from robogauntlet.policies.remote.conversion import decode_chunk, encode_observation, images_in
from robogauntlet.policies.remote.msgpack_numpy import PackingError
from robogauntlet.policies.remote.remote_policy import ConnectionLost, WebsocketPolicy
from robogauntlet.policies.remote.server_options import (
    ACTIONS_KEY,
    VLA_EVAL_CAMERAS,
    VLA_EVAL_INSTRUCTION,
    VLA_EVAL_STATE,
    Key,
    ServerOptions,
    WireProtocol,
)
from robogauntlet.policies.remote.vla_eval_messages import Kind, check_version, hello_frame, message_of, received
from robogauntlet.policies.remote.vla_eval_specs import fitted
from robogauntlet.suites.episode import Episode
from robogauntlet.support.text import visible

if TYPE_CHECKING:
    from robogauntlet.policies.remote.websocket import WebsocketConnection


class VlaEvalOptions(ServerOptions):
    """The options of the kind `vla-eval`. The server's specs say those that are not given, where they can."""

    PROTOCOL: ClassVar[str] = WireProtocol.VLA_EVAL.value
    FORM: ClassVar[str] = "vla-eval://HOST:PORT"
    ASKS_UNITS: ClassVar[bool] = True

    address: str
    """vla-eval://HOST:PORT, or ws:// or wss://"""
    cameras: dict[str, Key] = Field(default=VLA_EVAL_CAMERAS)
    """camera to its name among the images; by default the wrist is sent if the server asks for it"""
    proprioception: Key | None = VLA_EVAL_STATE
    """key of the eight numbers, or of joints and gripper; by default they are sent if the server asks for them"""
    instruction: Key | None = VLA_EVAL_INSTRUCTION
    """key of the goal in words; null to leave it out"""
    actions: Key = ACTIONS_KEY
    """key of the action in the answer"""
    execute: Annotated[int, Field(strict=True, ge=1, le=1)] | None = 1
    """1: the server keeps the chunk, and is asked at each control step"""


@dataclass
class _Session:
    """An episode on the server."""

    connection: WebsocketConnection
    number: int | None = None
    """That of the connection on which the episode began; None before its first answer."""


class VlaEvalPolicy(WebsocketPolicy):
    """Asks a model server for one action at each control step. Deterministic if the server is."""

    expected = "the HELLO of a model server of vla-evaluation-harness"
    hello = hello_frame()

    _connection: WebsocketConnection

    def __init__(self, options: ServerOptions) -> None:
        """Connect, unless `options.identity` names the policy."""
        self._fitted = options
        """The options with what the server's specs say."""
        self._sessions: dict[str, _Session] = {}
        self._numbers = itertools.count(1)
        super().__init__(options)
        self._free = [self._connection]
        """Connections without an episode."""
        self.spec = PolicySpec(
            PolicyInput.OBSERVATION, 1, options.action_dim, tuple(options.cameras), moves=options.moves
        )

    def reset(self, episodes: Sequence[Episode]) -> None:
        """Start these episodes; the server is told with their first query."""
        self.finish(episodes)

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """Ask the server each query, over the connection of its episode.

        Raises:
            PolicyError: See `ServerConnection.ask`; or the answer does not fit the options.
            ConnectionLost: The connection was lost within the episode, and with it the server's chunk.
        """
        return [self._decide(query) for query in queries]

    def finish(self, episodes: Sequence[Episode]) -> None:
        """End these episodes; their connections are used again."""
        for episode in episodes:
            if (session := self._sessions.pop(episode.id, None)) is not None:
                if session.number == session.connection.number:
                    session.connection.tell(self._frame(Kind.EPISODE_END, {}, next(self._numbers)))
                self._free.append(session.connection)

    def images_sent(self, query: Query) -> Mapping[str, Image]:
        """Return the images of a query as the server gets them, by its names of cameras."""
        self._connection.connect()  # the specs say which are sent
        return images_in(self._encoded(query))

    def close(self) -> None:
        """Close all connections."""
        for connection in (*self._free, *(session.connection for session in self._sessions.values())):
            connection.close()

    def _who(self) -> dict[str, Any]:
        return {**super()._who(), "address": self._options.address}  # the metadata name a class, not its weights

    def _silence(self) -> str:
        return "names no checkpoint"

    def _read_metadata(self, message: Mapping[str, Any]) -> Mapping[str, Any]:
        if "type" not in message:
            keys = visible(", ".join(sorted(map(str, message)))[:100]) or "nothing"
            raise PolicyError(
                f"{self._server}: expected {self.expected}, got a message of another protocol with {keys}; "
                "the address of a server of openpi's begins with openpi://"
            )
        said = self._payload(message, Kind.HELLO)
        try:
            check_version(said, "server")
            self._fitted = fitted(self._options, said)
        except (PackingError, PolicyMismatch) as error:
            raise PolicyMismatch(f"{self._server}: {error}") from None
        return said

    def _decide(self, query: Query) -> Decision:
        if query.step == 0:
            self.finish([query.episode])
        if query.episode.id not in self._sessions:
            self._sessions[query.episode.id] = _Session(self._free.pop() if self._free else self._new_connection())
        session, number = self._sessions[query.episode.id], next(self._numbers)
        answer = session.connection.ask(lambda: self._frames(session, query, number))
        try:
            decision = self._decision(answer, number, query.action_dim)
        except PolicyError:
            session.connection.close()  # more answers may follow
            raise
        session.number = session.connection.number
        return decision

    def _decision(self, answer: Mapping[str, Any], number: int, numbers: int) -> Decision:
        action = self._payload(answer, Kind.ACTION)
        try:
            if answer.get("seq") != number:
                raise PolicyMismatch("expected the answer to the query, got another; is inference continuous?")
            return Decision(decode_chunk(self._fitted, self._chunk(action), numbers))
        except (PackingError, PolicyMismatch) as error:
            raise PolicyMismatch(f"{self._server}: {error}") from None

    def _frames(self, session: _Session, query: Query, number: int) -> list[bytes]:
        encoded = self._encoded(query)
        images = images_in(encoded)
        rest = {key: value for key, value in encoded.items() if key not in images}
        observed = self._frame(Kind.OBSERVATION, {"images": images, **rest}, number)
        if session.number == session.connection.number:
            return [observed]
        if session.number is not None:
            raise ConnectionLost(f"{self._server} was lost during the episode")
        assert query.observation is not None
        task = {"name": query.observation.instruction, "suite": query.episode.task.partition("/")[0]}
        return [self._frame(Kind.EPISODE_START, {"task": task}, next(self._numbers)), observed]

    def _encoded(self, query: Query) -> dict[str, Any]:
        assert query.observation is not None
        return encode_observation(self._fitted, query.observation, query.episode)

    def _frame(self, kind: Kind, payload: Mapping[str, Any], number: int) -> bytes:
        return packed(message_of(kind, payload, number))

    def _payload(self, message: Mapping[str, Any], kind: Kind) -> Mapping[str, Any]:
        """Return the payload of a message of this kind. Raises PolicyError for another, or the server's error."""
        payload, got = message.get("payload"), message.get("type")
        if got == Kind.ERROR:
            text = payload.get("error") if isinstance(payload, dict) else payload
            raise PolicyError(f"{self._server}: expected an answer, got an error: {error_text(text)}")
        if got != kind or not isinstance(payload, dict):
            shown = visible(f"'{got}' with {type(payload).__name__}")[:MAX_ERROR_LENGTH]
            raise PolicyError(f"{self._server}: expected a message '{kind}' with a mapping, got {shown}")
        return payload

    def _chunk(self, action: Mapping[str, Any]) -> dict[str, Any]:
        """Return an action as a chunk of one, under the key of the options."""
        key = self._fitted.actions
        assert isinstance(key, str)
        if key not in action and "action" not in action:
            return dict(action)
        value = received(action.get(key, action.get("action")))
        if isinstance(value, np.ndarray):
            many = value.ndim > 1
        else:
            many = isinstance(value, list) and any(isinstance(row, list) for row in value)
        if many and len(value) > 1:
            raise PolicyMismatch(
                f"expected one action as '{key}', got {len(value)}; let the server keep the chunk: give it chunk_size"
            )
        return {key: value if many else [value]}
