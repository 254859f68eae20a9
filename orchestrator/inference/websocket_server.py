"""Serves a policy to other processes over a websocket, in openpi's protocol. No Ray.

The policy computes in one thread, since policies are not thread-safe; queries of several clients are queued or share a
batch. The sender of an invalid message gets one line of text; other clients are not affected.
"""

from __future__ import annotations

import asyncio
import hmac
import http
import logging
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count
from typing import Any

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from robogauntlet.orchestrator.inference.batcher import Batcher
from robogauntlet.orchestrator.inference.daemon_thread import DaemonThread
from robogauntlet.policies.contract import Decision, Policy, PolicyError, Query, check_chunk
from robogauntlet.policies.remote.msgpack_numpy import PackingError, pack, unpack
from robogauntlet.policies.remote.protocol import as_answer, as_metadata, episode_in, finished_in, greeting_of, query_in
from robogauntlet.suites.episode import Episode, Protocol, View
from robogauntlet.support.errors import describe
from robogauntlet.support.network import is_loopback

MAX_EPISODES = 1024
"""Maximum number of simultaneous episodes of one client."""
MAX_CLIENTS = 64
"""Maximum number of simultaneous connections."""
HORIZON = 1_000_000
"""Horizon of an episode that a client does not name."""
logger = logging.getLogger(__name__)


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

    def check(self) -> None:
        """Raise ServeError if other machines can reach the address and there is no token."""
        if self.token is None and not is_loopback(self.host):
            raise ServeError(
                f"--host {self.host}: expected a token in ROBOGAUNTLET_TOKEN, since others can reach this address; "
                "got none"
            )


@dataclass(frozen=True)
class IdentifiedPolicy:
    """A policy with its name and the hash of its content."""

    policy: Policy
    name: str
    digest: str
    task: str = "unknown/unknown"
    """Task of clients that do not name one."""


class PolicyServer:
    """One policy behind one address."""

    def __init__(self, served: IdentifiedPolicy, options: ServerOptions) -> None:
        """Raises ServeError: see `ServerOptions.check`."""
        options.check()
        self.served = served
        self._options = options
        self.greeting = greeting_of(served.policy, served.digest)
        self._metadata = pack(as_metadata(self.greeting) | {"policy": served.name})
        self._thread = DaemonThread()
        wait_s = options.wait_s if options.batch > 1 else 0.0
        self.batcher = Batcher[Query, Decision](served.policy.act, self._thread, max_batch=options.batch, wait_s=wait_s)
        self._players: dict[str, ServerConnection] = {}
        """Episode id to the connection that plays it."""
        self.unnamed: set[int] = set()
        """Seeds of the clients that do not name their episodes; a single client has 0."""
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
                server_header=None,
            )
        except OSError as error:
            why = error.strerror or str(error)
            raise ServeError(f"cannot listen on {options.host}:{options.port}: {why}; choose another --port") from None

    def close(self) -> None:
        """End the policy's thread."""
        self._thread.shutdown(wait=False, cancel_futures=True)

    def _admit(self, connection: ServerConnection, request: Request) -> Response | None:
        if self._options.token is not None:
            scheme, _, token = request.headers.get("Authorization", "").partition(" ")
            same = hmac.compare_digest(token.encode(errors="surrogateescape"), self._options.token.encode())
            if scheme not in ("Bearer", "Api-Key") or not same:
                return connection.respond(http.HTTPStatus.UNAUTHORIZED, "expected the server's token\n")
        if request.path == "/healthz":
            return connection.respond(http.HTTPStatus.OK, "OK\n")
        if self._clients >= MAX_CLIENTS:
            text = f"expected {MAX_CLIENTS} clients at most, got one more\n"
            return connection.respond(http.HTTPStatus.SERVICE_UNAVAILABLE, text)
        return None

    async def _serve(self, connection: ServerConnection) -> None:
        client = _Client(self, connection)
        self._clients += 1
        try:
            await connection.send(self._metadata)
            async for frame in connection:
                await connection.send(await client.answer(frame))
        except ConnectionClosed:
            pass
        finally:
            self._clients -= 1
            await client.leave()

    async def begin(self, connection: ServerConnection, episode: Episode) -> None:
        """Start an episode.

        Raises:
            PackingError: The policy has state, and another client plays the same episode.
        """
        player = self._players.get(episode.id)
        if self.greeting.remembers and player not in (None, connection):
            raise PackingError(
                f"expected an episode of this client alone, got {episode.id}, which another client plays"
            )
        self._players[episode.id] = connection
        try:
            await self._in_turn(self.served.policy.reset, [episode])
        except Exception:
            self._players.pop(episode.id, None)
            raise

    async def end(self, connection: ServerConnection, episodes: Sequence[Episode]) -> None:
        """Forget the connection's episodes."""
        finished = [episode for episode in episodes if self._players.get(episode.id) is connection]
        for episode in finished:
            del self._players[episode.id]
        if finished:
            await self._in_turn(self.served.policy.finish, finished)

    async def _in_turn(self, call: Any, episodes: Sequence[Episode]) -> None:
        await asyncio.get_running_loop().run_in_executor(self._thread, call, episodes)


class _Client:
    """The state of one connection."""

    def __init__(self, server: PolicyServer, connection: ServerConnection) -> None:
        self._server, self._connection = server, connection
        self._episodes: dict[str, Episode] = {}
        self._step = 0
        """Number of actions sent to a client that does not name its episode and step."""
        self._seed: int | None = None

    async def answer(self, frame: str | bytes) -> str | bytes:
        """Return a packed chunk, or a line of text with the error."""
        try:
            if isinstance(frame, str):
                raise PackingError("expected msgpack in a binary frame, got text")
            message = unpack(frame)
            if not isinstance(message, dict):
                raise PackingError(f"expected a mapping, got {type(message).__name__}")
            return await self._decide(message)
        except (PackingError, PolicyError) as error:
            return " ".join(str(error).split())
        except Exception as error:  # a policy may raise anything; other clients are still served
            logger.exception("the policy raised")
            return f"the policy raised {describe(error)}"

    async def leave(self) -> None:
        """Forget the client's episodes."""
        if self._seed is not None:
            self._server.unnamed.discard(self._seed)
        await self._server.end(self._connection, list(self._episodes.values()))

    async def _decide(self, message: dict[str, Any]) -> bytes:
        server, named = self._server, episode_in(message)
        finished = [self._episodes.pop(name) for name in finished_in(message) if name in self._episodes]
        if finished:
            await server.end(self._connection, finished)
        episode, step = named or (self._unnamed(), self._step)
        query = query_in(message, episode, step, server.served.policy.spec)
        if episode.id not in self._episodes or (named and not step):
            if step and server.greeting.remembers:
                raise PackingError(f"expected an episode from its first step on, got step {step} of one not begun here")
            if len(self._episodes) >= MAX_EPISODES:
                raise PackingError(f"expected {MAX_EPISODES} episodes of one client at most, got one more")
            await server.begin(self._connection, episode)
            self._episodes[episode.id] = episode
        start = time.perf_counter()
        (decision,) = await server.batcher.ask([query])
        chunk = check_chunk(decision.actions, query.action_dim)
        if named is None:
            self._step += len(chunk)
        answer = as_answer(Decision(chunk, decision.routing))
        return pack(answer | {"server_timing": {"infer_ms": 1000 * (time.perf_counter() - start)}})

    def _unnamed(self) -> Episode:
        served, taken = self._server.served, self._server.unnamed
        if self._seed is None:
            self._seed = next(seed for seed in count() if seed not in taken)
            taken.add(self._seed)
        spec = served.policy.spec
        view = View(spec.cameras or View().cameras, spec.image_size or View().image_size)
        return Episode(served.name, served.digest, served.task, self._seed, Protocol(HORIZON, spec.chunk_length, view))
