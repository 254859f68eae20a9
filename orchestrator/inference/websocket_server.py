"""Serves a policy to other processes over a websocket. No Ray.

Queries of several clients are queued or share a batch. The sender of an invalid message gets one line of text; other
clients are not affected.
"""

from __future__ import annotations

import hmac
import http
from dataclasses import dataclass

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from robogauntlet.orchestrator.inference.openpi_session import OpenpiSession
from robogauntlet.orchestrator.inference.session import Session
from robogauntlet.orchestrator.inference.shared_policy import IdentifiedPolicy, SharedPolicy
from robogauntlet.orchestrator.inference.vla_eval_session import VlaEvalSession
from robogauntlet.policies.contract import PolicyMismatch
from robogauntlet.policies.remote.server_options import WireProtocol
from robogauntlet.support.network import is_loopback

MAX_CLIENTS = 64
"""Maximum number of simultaneous connections."""
SESSIONS: dict[WireProtocol, type[Session]] = {
    WireProtocol.OPENPI: OpenpiSession,
    WireProtocol.VLA_EVAL: VlaEvalSession,
}


class ServeError(Exception):
    """The server cannot be started; the message has one line."""


@dataclass(frozen=True)
class ServerOptions:
    """Address, access and limits of the server."""

    host: str = "127.0.0.1"
    port: int = 8000
    """0 for any free port."""
    token: str | None = None
    """Token that clients must send; None for no authentication."""
    max_message_bytes: int = 16 * 2**20
    batch: int = 1
    """Maximum number of queries in a batch."""
    wait_s: float = 0.002
    """Maximum time that the first query of a batch waits for others."""
    protocol: WireProtocol = WireProtocol.OPENPI

    def check(self) -> None:
        """Raise ServeError if other machines can reach the address and there is no token."""
        if self.token is None and not is_loopback(self.host):
            raise ServeError(
                f"--host {self.host}: expected a token in ROBOGAUNTLET_TOKEN, since others can reach this address; "
                "got none"
            )


class PolicyServer:
    """One policy behind one address."""

    def __init__(self, served: IdentifiedPolicy, options: ServerOptions) -> None:
        """Raises ServeError: see `ServerOptions.check`; or the protocol cannot serve the policy."""
        options.check()
        self.served, self._options = served, options
        self.policy = SharedPolicy(served, batch=options.batch, wait_s=options.wait_s)
        self._session = SESSIONS[options.protocol]
        try:
            self._session(self.policy)  # refuses a policy that the protocol cannot describe
        except PolicyMismatch as error:
            self.close()
            raise ServeError(f"protocol {options.protocol}: {error}") from None
        self._clients = 0

    async def start(self) -> Server:
        """Listen; the returned server runs until it is closed.

        Raises:
            ServeError: The address cannot be used.
        """
        options = self._options
        try:
            return await serve(
                self._serve,
                options.host,
                options.port,
                compression=None,
                max_size=options.max_message_bytes,
                max_queue=1,  # queued messages per client
                process_request=self._admit,
                origins=[None],  # refuses browsers, which send an origin: web pages must not use a local server
                close_timeout=2,
                ping_interval=self._session.PING_S,
                server_header=None,
            )
        except OSError as error:
            why = error.strerror or str(error)
            raise ServeError(f"cannot listen on {options.host}:{options.port}: {why}; choose another --port") from None

    def close(self) -> None:
        """End the policy's thread."""
        self.policy.close()

    def _admit(self, connection: ServerConnection, request: Request) -> Response | None:
        if self._options.token is not None:
            scheme, _, token = request.headers.get("Authorization", "").partition(" ")
            same = hmac.compare_digest(token.encode(errors="surrogateescape"), self._options.token.encode())
            if scheme not in ("Bearer", "Api-Key") or not same:
                return connection.respond(http.HTTPStatus.UNAUTHORIZED, "expected the server's token\n")
        if request.path in ("/healthz", "/health"):
            return connection.respond(http.HTTPStatus.OK, "OK\n")
        if self._clients >= MAX_CLIENTS:
            text = f"expected {MAX_CLIENTS} clients at most, got one more\n"
            return connection.respond(http.HTTPStatus.SERVICE_UNAVAILABLE, text)
        return None

    async def _serve(self, connection: ServerConnection) -> None:
        session = self._session(self.policy)
        self._clients += 1
        try:
            if (greeting := session.greeting()) is not None:
                await connection.send(greeting)
            async for frame in connection:
                if (answer := await session.answer(frame)) is not None:
                    await connection.send(answer)
        except ConnectionClosed:
            pass
        finally:
            self._clients -= 1
            await session.leave()
