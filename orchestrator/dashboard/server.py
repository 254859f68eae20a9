"""The server of the dashboard: uvicorn, with deadlines for clients that send or read too slowly."""

from __future__ import annotations

import asyncio
import socket
from typing import ClassVar

import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol

CONNECTIONS = 500
"""Most connections at a time; more are answered with 503."""
SWITCH_S = 0.0005
"""How long a thread that computes keeps others waiting (s): a page waits for its turn dozens of times."""


class DeadlineProtocol(H11Protocol):
    """A connection that ends if its client sends a header, or reads an answer, too slowly."""

    HEADER_S: ClassVar[float] = 10.0
    """Longest time from the start of a connection, or the end of an answer, to the end of the next header (s)."""
    READ_S: ClassVar[float] = 30.0
    """Longest time in which a client reads nothing of an answer that waits for it (s)."""
    _header: asyncio.TimerHandle | None = None
    _read: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin a connection."""
        super().connection_made(transport)
        # asyncio does this only for sockets that were opened with a protocol number. Without it the kernel keeps the
        # body of an answer back, for 40 ms, until the client has confirmed its header.
        transport.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._watch_header()

    def data_received(self, data: bytes) -> None:
        """Take bytes of a header or a body."""
        super().data_received(data)
        self._watch_header()

    def on_response_complete(self) -> None:
        """Wait for the next request."""
        super().on_response_complete()
        self._watch_header()

    def pause_writing(self) -> None:
        """Wait for a client that does not read its answer."""
        super().pause_writing()
        if self._read is None:
            self._read = self.loop.call_later(self.READ_S, self.transport.abort)

    def resume_writing(self) -> None:
        """Go on, since the client has read."""
        super().resume_writing()
        self._stop_read()

    def connection_lost(self, exc: Exception | None) -> None:
        """End a connection."""
        self._stop_header()
        self._stop_read()
        super().connection_lost(exc)

    def _watch_header(self) -> None:
        is_answering = self.cycle is not None and not self.cycle.response_complete
        if is_answering:
            self._stop_header()
        elif self._header is None and not self.transport.is_closing():
            self._header = self.loop.call_later(self.HEADER_S, self.transport.abort)

    def _stop_header(self) -> None:
        if self._header is not None:
            self._header.cancel()
            self._header = None

    def _stop_read(self) -> None:
        if self._read is not None:
            self._read.cancel()
            self._read = None


def server_config(app: ASGIApp, *, protocol: type[DeadlineProtocol] = DeadlineProtocol) -> uvicorn.Config:
    """Return uvicorn's settings for the dashboard."""
    return uvicorn.Config(
        app,
        http=protocol,
        limit_concurrency=CONNECTIONS,
        log_level="warning",
        access_log=False,
        server_header=False,
        ws="none",
        timeout_graceful_shutdown=3,
    )
