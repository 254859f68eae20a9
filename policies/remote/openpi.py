"""A policy behind a server of openpi's protocol: openpi's, vLLM-Omni's or RoboGauntlet's own.

The protocol is that of https://github.com/Physical-Intelligence/openpi (Apache 2.0): the server sends metadata on
connection, then answers each observation with a chunk, both as msgpack; a text frame is an error. See `openpi_config`
for what vLLM-Omni adds.
"""

from __future__ import annotations

import uuid
from collections.abc import Mapping, Sequence
from typing import Any

from robogauntlet.adapters.contract import Image
from robogauntlet.policies.contract import Decision, PolicyError, PolicyInput, PolicyMismatch, PolicySpec, Query
from robogauntlet.policies.remote.connection import packed
from robogauntlet.policies.remote.conversion import (
    MAX_ACTIONS,
    decode_chunk,
    encode_observation,
    images_in,
    read_chunk,
)
from robogauntlet.policies.remote.msgpack_numpy import PackingError
from robogauntlet.policies.remote.openpi_config import (
    PolicyServerConfig,
    check_options,
    config_in,
    explained,
    one_of_batch,
    request_part,
)
from robogauntlet.policies.remote.protocol import Greeting, as_message, greeting_in, routing_in
from robogauntlet.policies.remote.remote_policy import ConnectionLost, WebsocketPolicy
from robogauntlet.policies.remote.server_options import ACTIONS_KEY, ServerOptions
from robogauntlet.suites.episode import Episode


class OpenpiPolicy(WebsocketPolicy):
    """Asks a server of openpi's protocol, one query at a time. Deterministic if the server is."""

    expected = "metadata on connection, as openpi's servers send"
    alone = ACTIONS_KEY
    explain = staticmethod(explained)

    def __init__(self, options: ServerOptions) -> None:
        """Connect, unless `options.identity` names the policy."""
        self._greeting: Greeting | None = None
        self._config: PolicyServerConfig | None = None
        self._episode, self._session = "", ""
        """The episode whose session is open, and its name."""
        self._connection_of: dict[str, int] = {}
        """Episode to the number of the connection that it is played over."""
        self._finished: list[str] = []
        super().__init__(options)
        execute = options.execute or MAX_ACTIONS
        self.spec = PolicySpec(
            PolicyInput.OBSERVATION, execute, options.action_dim, tuple(options.cameras), moves=options.moves
        )
        if options.identity is None and self._greeting is not None and options.is_plain:
            self.spec = self._greeting.spec

    def digest(self) -> str:
        """Return the hash of the policy's content, see `docs/your-policy.md`."""
        if self._options.identity is None and self._is_robogauntlet:
            assert self._greeting is not None
            return self._greeting.digest
        return super().digest()

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

    @property
    def _is_robogauntlet(self) -> bool:
        """Whether the server is RoboGauntlet's own, without conversions."""
        return self._greeting is not None and self._options.is_plain

    def _read_metadata(self, message: Mapping[str, Any]) -> Mapping[str, Any]:
        try:
            self._greeting = greeting_in(message)
            self._config = config_in(message)
            if self._config is not None:
                check_options(self._config, self._options)
        except (PackingError, PolicyMismatch) as error:
            raise PolicyMismatch(f"{self._server}: {error}") from None
        return message

    def _who(self) -> dict[str, Any]:
        who = super()._who()
        return who if self._config is None else {**who, "address": self._options.address}  # it names no weights

    def _silence(self) -> str:
        return super()._silence() if self._config is None else "names no checkpoint"

    def _decide(self, query: Query) -> Decision:
        answer = self._connection.ask(lambda: [self._frame(query)])
        self._connection_of[query.episode.id] = self._connection.number
        self._finished.clear()
        try:
            if self._config is not None:
                answer = one_of_batch(answer)
            if self._is_robogauntlet:
                return Decision(read_chunk(answer, ACTIONS_KEY, query.action_dim, exactly=True), routing_in(answer))
            return Decision(
                decode_chunk(self._options, answer, query.action_dim), routing_in(answer) if self._greeting else None
            )
        except (PackingError, PolicyMismatch) as error:
            raise PolicyMismatch(f"{self._server}: {error}") from None
        except PolicyError as error:
            raise PolicyError(f"{self._server}: {error}") from None

    def _frame(self, query: Query) -> bytes:
        current = self._connection.number
        started = self._connection_of.get(query.episode.id, current) if query.step else current
        if started != current and self._remembers:
            raise ConnectionLost(f"{self._server} was lost during the episode")
        message = self._message(query)
        if self._config is not None:
            message |= request_part(self._config, self._options, query, self._session_of(query))
        return packed(message)

    @property
    def _remembers(self) -> bool:
        """Whether the server keeps state of an episode, which is lost with the connection."""
        if self._config is not None:
            return self._config.needs_session_id
        return self._greeting is not None and self._greeting.remembers

    def _session_of(self, query: Query) -> str:
        episode = query.episode.id
        if query.step == 0 or episode not in self._connection_of:
            self._episode, self._session = episode, f"{episode}-{uuid.uuid4().hex[:8]}"
        elif self._episode != episode and self._remembers:
            raise PolicyError(
                f"{self._server}: expected one episode at a time, since a session ends when another begins, got "
                "several; leave inference: worker"
            )
        return self._session

    def _message(self, query: Query) -> dict[str, Any]:
        if self._is_robogauntlet:
            return as_message(query, self._finished)
        assert query.observation is not None
        message = encode_observation(self._options, query.observation, query.episode)
        if self._greeting is not None:
            complete = as_message(query, self._finished)
            message |= {key: complete[key] for key in complete if key.startswith("robogauntlet/")}
        return message
