"""Serves a policy to other processes over a websocket, in openpi's protocol. No Ray.

The policy computes in one thread, since policies are not made for several; queries of several clients wait for their
turn, or share a batch. A bad message costs its sender one line of text and nobody anything else.
"""

from __future__ import annotations

import asyncio
import hmac
import http
import ipaddress
import logging
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import count
from typing import Any

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from orchestrator.batching import Batcher
from policies.contract import Decision, Policy, PolicyError, Query, check_chunk
from policies.remote.episodes import as_answer, as_metadata, episode_in, finished_in, greeting_of, query_in
from policies.remote.packing import PackingError, pack, unpack
from suites.vocabulary import Episode, Protocol, View

MOST_EPISODES = 1024
"""That one client may play at the same time."""
HORIZON = 1_000_000
"""Of an episode that a client does not name."""
logger = logging.getLogger(__name__)


class ServeError(Exception):
    """The server cannot be started as asked; one line."""


@dataclass(frozen=True)
class Place:
    """Where and for whom to serve."""

    host: str = "127.0.0.1"
    port: int = 8000
    """0 for any that is free."""
    token: str | None = None
    """What clients must show; None to ask for nothing."""
    most_bytes: int = 16 * 2**20
    """Of a frame."""
    batch: int = 1
    """Queries in one batch at most."""
    wait_s: float = 0.002
    """Time for which the first query of a batch waits for others."""

    def check(self) -> None:
        """Refuse to serve strangers.

        Raises:
            ServeError: It is not a loopback address, and there is no token.
        """
        if self.token is None and not _is_loopback(self.host):
            raise ServeError(
                f"--host {self.host}: expected a token in GAUNTLET_TOKEN, since others can reach this address; got none"
            )


@dataclass(frozen=True)
class Served:
    """A policy with its name and the hash of its content."""

    policy: Policy
    name: str
    digest: str
    task: str = "unknown/unknown"
    """Of clients that do not name theirs."""


class PolicyServer:
    """One policy behind one address."""

    def __init__(self, served: Served, place: Place) -> None:
        """Raises ServeError: see `Place.check`."""
        place.check()
        self.served = served
        self._place = place
        self.greeting = greeting_of(served.policy, served.digest)
        self._metadata = pack(as_metadata(self.greeting) | {"policy": served.name})
        self._thread = ThreadPoolExecutor(1)
        self.batcher = Batcher[Query, Decision](
            served.policy.act, self._thread, most=place.batch, wait_s=place.wait_s if place.batch > 1 else 0.0
        )
        self._players: dict[str, ServerConnection] = {}
        """Episode to the connection that plays it."""
        self.unnamed: set[int] = set()
        """Seeds of the clients that name no episode; a client alone has 0."""

    async def start(self) -> Server:
        """Listen; what is returned serves until it is closed.

        Raises:
            ServeError: The address cannot be had.
        """
        place = self._place
        try:
            return await serve(
                self._serve,
                place.host,
                place.port,
                compression=None,
                max_size=place.most_bytes,
                max_queue=4,  # frames of one client that wait
                process_request=self._admit,
                origins=[None],  # browsers name theirs: no web page may talk to a server on this machine
                close_timeout=2,
                server_header=None,
            )
        except OSError as error:
            why = error.strerror or str(error)
            raise ServeError(f"{place.host}:{place.port} cannot be listened on: {why}; give another --port") from None

    def close(self) -> None:
        """Let the policy's thread end."""
        self._thread.shutdown(wait=False, cancel_futures=True)

    def _admit(self, connection: ServerConnection, request: Request) -> Response | None:
        if self._place.token is not None:
            scheme, _, shown = request.headers.get("Authorization", "").partition(" ")
            wanted = self._place.token.encode()
            if scheme not in ("Bearer", "Api-Key") or not hmac.compare_digest(
                shown.encode(errors="surrogateescape"), wanted
            ):
                return connection.respond(http.HTTPStatus.UNAUTHORIZED, "expected the server's token\n")
        if request.path == "/healthz":
            return connection.respond(http.HTTPStatus.OK, "OK\n")
        return None

    async def _serve(self, connection: ServerConnection) -> None:
        client = _Client(self, connection)
        try:
            await connection.send(self._metadata)
            async for frame in connection:
                await connection.send(await client.answer(frame))
        except ConnectionClosed:
            pass
        finally:
            await client.leave()

    async def begin(self, connection: ServerConnection, episode: Episode) -> None:
        """Start an episode.

        Raises:
            PackingError: Another client plays it, and the policy cannot tell them apart.
        """
        player = self._players.get(episode.id)
        if self.greeting.remembers and player not in (None, connection):
            raise PackingError(f"expected an episode that nobody plays, got {episode.id}, which another client plays")
        self._players[episode.id] = connection
        try:
            await self._in_turn(self.served.policy.reset, [episode])
        except Exception:
            self._players.pop(episode.id, None)
            raise

    async def end(self, connection: ServerConnection, episodes: Sequence[Episode]) -> None:
        """Forget episodes, unless somebody else plays them now."""
        own = [episode for episode in episodes if self._players.get(episode.id) is connection]
        for episode in own:
            del self._players[episode.id]
        if own:
            await self._in_turn(self.served.policy.finish, own)

    async def ask(self, query: Query) -> Decision:
        """The policy's answer."""
        (decision,) = await self.batcher.ask([query])
        return decision

    async def _in_turn(self, call: Any, episodes: Sequence[Episode]) -> None:
        await asyncio.get_running_loop().run_in_executor(self._thread, call, episodes)


class _Client:
    """What the server knows of one connection."""

    def __init__(self, server: PolicyServer, connection: ServerConnection) -> None:
        self._server, self._connection = server, connection
        self._episodes: dict[str, Episode] = {}
        self._step = 0
        """Of a client that does not say: actions given so far."""
        self._seed: int | None = None

    async def answer(self, frame: str | bytes) -> str | bytes:
        """A packed chunk, or a line that says what is wrong."""
        try:
            if isinstance(frame, str):
                raise PackingError("expected msgpack in a binary frame, got text")
            message = unpack(frame)
            if not isinstance(message, dict):
                raise PackingError(f"expected a mapping, got a {type(message).__name__}")
            return await self._decide(message)
        except (PackingError, PolicyError) as error:
            return " ".join(str(error).split())
        except Exception as error:  # a policy may raise anything, and must not take the other clients along
            logger.exception("the policy raised")
            lines = str(error).strip().splitlines()
            return f"the policy raised {type(error).__name__}{': ' + lines[0] if lines else ''}"

    async def leave(self) -> None:
        """Forget the client's episodes."""
        if self._seed is not None:
            self._server.unnamed.discard(self._seed)
        await self._server.end(self._connection, list(self._episodes.values()))

    async def _decide(self, message: dict[str, Any]) -> bytes:
        server, said = self._server, episode_in(message)
        over = [self._episodes.pop(name) for name in finished_in(message) if name in self._episodes]
        if over:
            await server.end(self._connection, over)
        episode, step = said or (self._unnamed(), self._step)
        query = query_in(message, episode, step, server.served.policy.spec)
        if episode.id not in self._episodes or (said and not step):
            if step and server.greeting.remembers:
                raise PackingError(f"expected an episode from its first step on, got step {step} of one not begun here")
            if len(self._episodes) >= MOST_EPISODES:
                raise PackingError(f"expected {MOST_EPISODES} episodes of one client at most, got one more")
            await server.begin(self._connection, episode)
            self._episodes[episode.id] = episode
        start = time.perf_counter()
        decision = await server.ask(query)
        chunk = check_chunk(decision.actions)
        if said is None:
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


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
