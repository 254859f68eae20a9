"""A policy behind a policy server."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robogauntlet.adapters.contract import ACTION_DIM, Image
from robogauntlet.policies.contract import (
    Contact,
    Decision,
    PolicyError,
    PolicyInput,
    PolicyMismatch,
    PolicySpec,
    Query,
)
from robogauntlet.policies.remote.connection import ServerConnection, packed
from robogauntlet.policies.remote.conversion import (
    MAX_ACTIONS,
    decode_chunk,
    encode_observation,
    images_in,
    read_chunk,
)
from robogauntlet.policies.remote.msgpack_numpy import PackingError
from robogauntlet.policies.remote.protocol import Greeting, as_message, greeting_in, routing_in
from robogauntlet.policies.remote.server_options import ACTIONS_KEY, ServerOptions
from robogauntlet.suites.episode import Episode, content_hash


class ConnectionLost(Exception):
    """The connection was lost, and with it the server's state of an episode. The episode can be played again."""


class RemotePolicy:
    """Asks a server of openpi's protocol, one query at a time. Deterministic if the server is."""

    def __init__(self, options: ServerOptions) -> None:
        """Connect, unless `options.identity` names the policy."""
        self._options, self._connection = options, ServerConnection(options)
        self._digest, self._metadata = "", options.expected_metadata
        self._greeting: Greeting | None = None
        self._greeted_connection = -1
        """Number of the connection whose greeting was read."""
        self._connection_of: dict[str, int] = {}
        """Episode to the number of the connection that it is played over."""
        self._finished: list[str] = []
        if options.identity is None:
            self._connection.connect()
            self._read_greeting()
            self._digest = self.digest()
        execute = options.execute or MAX_ACTIONS
        numbers = options.width if options.joints else ACTION_DIM
        self.spec = PolicySpec(PolicyInput.OBSERVATION, execute, numbers, tuple(options.cameras))
        if options.identity is None and self._greeting is not None and options.is_plain:
            self.spec = self._greeting.spec

    def digest(self) -> str:
        """Return the hash of the policy's content, see `docs/your-policy.md`."""
        if self._options.identity is not None:
            return self._options.digest({"identity": self._options.identity})
        if self._is_robogauntlet:
            assert self._greeting is not None
            return self._greeting.digest
        if not self._connection.metadata:
            return self._options.digest({"address": self._options.address})
        return self._options.digest({"metadata": _plain(self._connection.metadata)})

    def contact(self, options: Mapping[str, Any]) -> Contact:
        """Connect, and return what the server says of itself; `options` are those of the suite.

        Raises PolicyUnreachable if it does not answer.
        """
        self._connection.connect()
        self._read_greeting()
        if self._options.identity is not None:
            return Contact({**options, "expected_metadata": self._metadata}, self._metadata)
        warning = (
            ""
            if self._connection.metadata
            else (
                f"is known by its address {self._options.address} alone, as its server says nothing of itself, so that "
                "checkpoints behind it cannot be told apart; give option identity: a checkpoint's name or hash"
            )
        )
        return Contact(options, warning=warning)

    def reset(self, episodes: Sequence[Episode]) -> None:
        """Start these episodes; nothing is sent."""
        for episode in episodes:
            self._connection_of.pop(episode.id, None)

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """Ask the server each query.

        Raises:
            PolicyError: See `ServerConnection.ask`; or the answer does not fit the options.
            ConnectionLost: The server keeps state of its episodes, and the connection was lost within the episode.
        """
        return [self._decide(query) for query in queries]

    def finish(self, episodes: Sequence[Episode]) -> None:
        """Drop these episodes; the next query reports them to a RoboGauntlet server."""
        self._finished += [episode.id for episode in episodes if self._connection_of.pop(episode.id, None) is not None]

    def images_sent(self, query: Query) -> Mapping[str, Image]:
        """Return the images of a query as the server gets them, by its keys."""
        return images_in(self._message(query))

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()

    @property
    def _is_robogauntlet(self) -> bool:
        """Whether the server is RoboGauntlet's own, without conversions."""
        return self._greeting is not None and self._options.is_plain

    def _decide(self, query: Query) -> Decision:
        answer = self._connection.ask(lambda: self._frame(query))
        self._connection_of[query.episode.id] = self._connection.number
        self._finished.clear()
        try:
            if self._is_robogauntlet:
                return Decision(read_chunk(answer, ACTIONS_KEY, query.action_dim, exactly=True), routing_in(answer))
            return Decision(decode_chunk(self._options, answer), routing_in(answer) if self._greeting else None)
        except (PackingError, PolicyMismatch) as error:
            raise PolicyMismatch(f"policy server {self._options.address}: {error}") from None

    def _frame(self, query: Query) -> bytes:
        self._read_greeting()
        current = self._connection.number
        started = self._connection_of.get(query.episode.id, current) if query.step else current
        if started != current and self._greeting is not None and self._greeting.remembers:
            raise ConnectionLost(f"policy server {self._options.address} was lost during the episode")
        return packed(self._message(query))

    def _read_greeting(self) -> None:
        """Read the server's greeting if the connection is new."""
        if self._greeted_connection == self._connection.number:
            return
        try:
            self._greeting = greeting_in(self._connection.metadata)
        except PackingError as error:
            self._connection.close()
            raise PolicyError(f"policy server {self._options.address}: {error}") from None
        if self._digest and self.digest() != self._digest:
            self._connection.close()
            raise PolicyError(
                f"policy server {self._options.address}: expected the policy that the run was planned with, "
                "got another policy"
            )
        metadata = content_hash(_plain(self._connection.metadata))
        if self._options.identity is not None and metadata != (self._metadata or metadata):
            self._connection.close()
            raise PolicyError(
                f"policy server {self._options.address}: its metadata have changed under identity "
                f"'{self._options.identity}'; give another checkpoint another identity"
            )
        self._metadata = metadata
        self._greeted_connection = self._connection.number

    def _message(self, query: Query) -> dict[str, Any]:
        if self._is_robogauntlet:
            return as_message(query, self._finished)
        assert query.observation is not None
        message = encode_observation(self._options, query.observation, query.episode)
        if self._greeting is not None:
            complete = as_message(query, self._finished)
            message |= {key: complete[key] for key in complete if key.startswith("robogauntlet/")}
        return message


def _plain(value: Any) -> Any:
    """Return metadata as JSON values."""
    match value:
        case dict():
            return {str(key): _plain(item) for key, item in value.items()}
        case list() | tuple():
            return [_plain(item) for item in value]
        case np.ndarray() | np.generic():
            return _plain(value.tolist())
        case None | bool() | int() | str():
            return value
        case _:
            return repr(value)
