"""A deadline for the bodies of requests: they have to arrive at a minimum rate."""

from __future__ import annotations

import asyncio

from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

GRACE_S = 20.0
"""Time that every body may take (s)."""
LEAST_RATE = 16 * 1024
"""Least rate of a body that takes longer (bytes per second)."""


class BodyDeadline:
    """Ends requests whose body arrives too slowly, with 408.

    The time begins when the application asks for the body, so that waiting for a place costs the client nothing.
    """

    def __init__(self, app: ASGIApp, grace_s: float = GRACE_S) -> None:
        """Watch the bodies that `app` reads; each may take `grace_s` and longer at `LEAST_RATE`."""
        self._app, self._grace_s = app, grace_s

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        loop, begun, size, is_whole = asyncio.get_running_loop(), 0.0, 0, False

        async def receive_in_time() -> Message:
            nonlocal begun, size, is_whole
            if is_whole:
                return await receive()  # waits for the end of the connection
            begun = begun or loop.time()
            try:
                async with asyncio.timeout_at(begun + self._grace_s + size / LEAST_RATE):
                    message = await receive()
            except TimeoutError:
                words = f"the body came too slowly: expected {LEAST_RATE // 1024} kB a second or more"
                raise HTTPException(408, words, {"connection": "close"}) from None
            size += len(message.get("body", b""))
            is_whole = not message.get("more_body", False)
            return message

        await self._app(scope, receive_in_time, send)
