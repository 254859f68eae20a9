"""A policy behind a policy server: what all protocols have in common."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from robogauntlet.policies.contract import Contact, Decision, PolicyError, Query
from robogauntlet.policies.remote.connection import ServerConnection, error_text
from robogauntlet.policies.remote.server_options import ServerOptions
from robogauntlet.suites.episode import Episode, content_hash

if TYPE_CHECKING:
    from robogauntlet.policies.remote.websocket import WebsocketConnection


class ConnectionLost(Exception):
    """The connection was lost, and with it the server's state of an episode. The episode can be played again."""


class RemotePolicy:
    """Base of the policies behind a server; each protocol has its own."""

    def __init__(self, options: ServerOptions) -> None:
        """Connect, unless `options.identity` names the policy."""
        self._options = options
        self._metadata: Mapping[str, Any] = {}
        """What the server said of itself on the last connection."""
        self._digest, self._metadata_hash = "", options.expected_metadata
        self._connection = self._new_connection()
        if options.identity is None:
            self._connection.connect()
            self._digest = self.digest()

    def digest(self) -> str:
        """Return the hash of the policy's content, see `docs/your-policy.md`."""
        identity = self._options.identity
        return self._options.digest(self._who() if identity is None else {"identity": identity})

    def contact(self, options: Mapping[str, Any]) -> Contact:
        """Connect, and return what the server says of itself; `options` are those of the suite.

        Raises PolicyUnreachable if it does not answer.
        """
        self._connection.connect()
        if self._options.identity is not None:
            return Contact({**options, "expected_metadata": self._metadata_hash}, self._metadata_hash)
        warning = (
            f"is known by its address {self._options.address} alone, as its server {silence}, so that "
            "checkpoints behind it cannot be told apart; give option identity: a checkpoint's name or hash"
            if (silence := self._silence())
            else ""
        )
        return Contact(options, warning=warning)

    def reset(self, episodes: Sequence[Episode]) -> None:
        """Do nothing: most servers are told of an episode by its first query, or not at all."""

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """Ask the server each query.

        Raises:
            PolicyError: See `ServerConnection.ask`; or the answer does not fit the options.
        """
        return [self._decide(query) for query in queries]

    def finish(self, episodes: Sequence[Episode]) -> None:
        """Do nothing: most servers keep no state."""

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()

    @property
    def _server(self) -> str:
        return f"policy server {self._options.address}"

    def _new_connection(self) -> ServerConnection:
        """Return a connection that hands `_accept` what the server says of itself."""
        raise NotImplementedError

    def _decide(self, query: Query) -> Decision:
        """Ask the server one query. Raises as `act`."""
        raise NotImplementedError

    def _read_metadata(self, message: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return the metadata in a server's first message. Raises PolicyError for a server that cannot be asked."""
        return message

    def _who(self) -> dict[str, Any]:
        """Return what tells the policy from others without an identity, as plain values."""
        return {"metadata": plain(self._metadata)} if self._metadata else {"address": self._options.address}

    def _silence(self) -> str:
        """Return what the server does in place of naming its checkpoint, or "" if its metadata may tell it."""
        return "" if self._metadata else "says nothing of itself"

    def _accept(self, message: Mapping[str, Any]) -> None:
        """Read what the server says of itself on a new connection. Raises PolicyError if it is not the same policy."""
        self._metadata = self._read_metadata(message)
        if self._digest and self.digest() != self._digest:
            raise PolicyError(f"{self._server}: expected the policy that the run was planned with, got another policy")
        found = content_hash(plain(self._metadata))
        if self._options.identity is not None and found != (self._metadata_hash or found):
            raise PolicyError(
                f"{self._server}: its metadata have changed under identity '{self._options.identity}'; "
                "give another checkpoint another identity"
            )
        self._metadata_hash = found


class WebsocketPolicy(RemotePolicy):
    """Base of the policies behind a websocket."""

    expected = ""
    """What a server of the protocol sends first."""
    hello: bytes | None = None
    """What a client of the protocol sends before."""
    alone = ""
    """Key of an answer that is an array alone; "" if that is an error."""
    explain = staticmethod(error_text)
    """Returns the error in a text frame."""

    def _new_connection(self) -> WebsocketConnection:
        from robogauntlet.policies.remote.websocket import Opening, WebsocketConnection  # takes 0.1 s

        opening = Opening(self.expected, self._accept, self.hello, self.alone, self.explain)
        return WebsocketConnection(self._options, opening)


def plain(value: Any) -> Any:
    """Return metadata as JSON values."""
    match value:
        case dict():
            return {str(key): plain(item) for key, item in value.items()}
        case list() | tuple():
            return [plain(item) for item in value]
        case np.ndarray() | np.generic():
            return plain(value.tolist())
        case None | bool() | int() | str():
            return value
        case _:
            return repr(value)
