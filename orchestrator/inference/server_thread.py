"""A policy server in a thread of this process, for objects that only this process has."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Coroutine
from contextlib import suppress
from typing import Any, Self, TypeVar

from robogauntlet.orchestrator.inference.shared_policy import IdentifiedPolicy
from robogauntlet.orchestrator.inference.websocket_server import PolicyServer, ServerOptions

Result = TypeVar("Result")
ANSWER_S = 10.0
"""Longest time that the thread may take to open or close the server."""


class ServerThread:
    """Serves a policy on loopback, until the block ends. The policy computes in one thread of its own."""

    def __init__(self, served: IdentifiedPolicy, options: ServerOptions | None = None) -> None:
        """Start nothing; by default any free port is used."""
        self.server = PolicyServer(served, options or ServerOptions(port=0))
        self.loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self.loop.run_forever, name="policy server", daemon=True)

    def __enter__(self) -> Self:
        """Listen. Raises ServeError if the address cannot be used."""
        self._thread.start()
        try:
            self.listening = self.call(self.server.start())
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        async def close() -> None:
            self.listening.close()
            await self.listening.wait_closed()

        try:
            with suppress(TimeoutError):  # the policy may hang
                self.call(close())
        finally:
            self._end()

    @property
    def port(self) -> int:
        """The port that it listens on."""
        return int(self.listening.sockets[0].getsockname()[1])

    @property
    def address(self) -> str:
        """The address for option `address` of the policy kind `openpi`."""
        return f"ws://127.0.0.1:{self.port}"

    def call(self, what: Coroutine[Any, Any, Result]) -> Result:
        """Run a coroutine in the server's thread and return its result."""
        return asyncio.run_coroutine_threadsafe(what, self.loop).result(ANSWER_S)

    def _end(self) -> None:
        self.server.close()
        self.loop.call_soon_threadsafe(self.loop.stop)
        self._thread.join(ANSWER_S)
        if not self._thread.is_alive():
            self.loop.close()
