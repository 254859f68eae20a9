"""One connection of a policy server: what all wire protocols have in common."""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from typing import Any, ClassVar

from robogauntlet.orchestrator.inference.shared_policy import SharedPolicy
from robogauntlet.policies.contract import PolicyError
from robogauntlet.policies.remote.msgpack_numpy import PackingError, unpack
from robogauntlet.suites.episode import Episode
from robogauntlet.support.errors import describe
from robogauntlet.support.text import visible

logger = logging.getLogger(__name__)


class Session(ABC):
    """The state of one connection; each protocol has its own class."""

    PING_S: ClassVar[float | None] = 20.0
    """Time between pings, or None where a client may be too busy to answer them."""

    def __init__(self, policy: SharedPolicy) -> None:
        """A connection without an episode. Raises PolicyMismatch for a policy that the protocol cannot serve."""
        self._policy = policy
        self._episodes: dict[str, Episode] = {}

    def greeting(self) -> bytes | None:
        """Return what the server sends first, if it does."""
        return None

    async def answer(self, frame: str | bytes) -> str | bytes | None:
        """Return the answer to a frame, which may be a line with the error; None if it has no answer."""
        message: dict[str, Any] = {}
        try:
            if isinstance(frame, str):
                raise PackingError("expected msgpack in a binary frame, got text")
            unpacked = unpack(frame)
            if not isinstance(unpacked, dict):
                raise PackingError(f"expected a mapping, got {type(unpacked).__name__}")
            message = unpacked
            return await self.decide(message)
        except Exception as error:  # a policy may raise anything; other clients are still served
            return self.refusal(line_of(error), message)

    @abstractmethod
    async def decide(self, message: dict[str, Any]) -> bytes | None:
        """Return the answer to a message, if it has one. Raises PackingError if it is malformed."""

    @abstractmethod
    def refusal(self, line: str, message: dict[str, Any]) -> str | bytes:
        """Return a line as an answer to a message, which is empty if it could not be read."""

    async def leave(self) -> None:
        """Forget the client's episodes."""
        episodes, self._episodes = list(self._episodes.values()), {}
        await self._policy.end(self, episodes)


def line_of(error: Exception) -> str:
    """Return an error in one line, and log one that is not the client's."""
    if isinstance(error, PackingError | PolicyError):
        return visible(" ".join(str(error).split()))
    logger.error("the policy raised", exc_info=error)
    return visible(f"the policy raised {describe(error)}")
