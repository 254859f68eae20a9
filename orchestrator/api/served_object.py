"""Objects of the running process as policies of a run: they stay in it, and the workers ask it by a policy server."""

from __future__ import annotations

import inspect
import textwrap
import uuid
from collections.abc import Iterator
from types import CodeType, ModuleType
from typing import Any

import numpy as np

from robogauntlet.adapters.contract import ACTION_DIM, PROPRIOCEPTION_DIM
from robogauntlet.orchestrator.inference.server_thread import ServerThread
from robogauntlet.orchestrator.inference.websocket_server import IdentifiedPolicy
from robogauntlet.policies.contract import PolicyMismatch, check_chunk
from robogauntlet.policies.function_policy import as_policy
from robogauntlet.suites.episode import content_hash
from robogauntlet.suites.schema import PolicyEntry, valid_name

TIMEOUT_S = 600.0
"""Time that an object has for an answer; the queries of all workers wait for each other."""


class ServedObject(ServerThread):
    """A function, a class, an object that is called, or a policy of the contract, served on loopback."""

    def __init__(self, target: Any, *, name: str | None = None, identity: str | None = None) -> None:
        """Build the policy.

        Args:
            target: The object, see `robogauntlet.evaluate`.
            name: Its name in the run; by default that of the function or class.
            identity: Text that identifies its content, such as the name or hash of a checkpoint. By default the content
                of a function that uses nothing but its parameters and modules is its source, and any other object
                counts as a new policy at each call.

        Raises:
            PolicyError: It is no policy; the message says what to write.
        """
        own: str = getattr(target, "__name__", type(target).__name__)
        self.name, self._target = valid_name(name or own) or "policy", target
        itself = inspect.isroutine(target) or inspect.isclass(target)
        policy = as_policy(target if itself else lambda: target, {}, self.name)
        super().__init__(IdentifiedPolicy(policy, self.name, _digest(target, identity)))

    @property
    def is_sequential(self) -> bool:
        """Whether it keeps the state of one episode, so that it plays one at a time."""
        is_policy = inspect.isclass(self._target) or hasattr(self._target, "act")
        return not is_policy and callable(getattr(self._target, "reset", None))

    @property
    def entry(self) -> PolicyEntry:
        """The policy in a suite, while it is served."""
        return PolicyEntry(
            name=self.name, kind="openpi", options={"address": self.address, "timeout_s": TIMEOUT_S, "retries": 0}
        )

    def check_answer(self, cameras: tuple[str, ...], image_size: int, instruction: str) -> None:
        """Refuse a function whose answer to black images has a wrong shape. That it raises is no reason.

        Raises:
            PolicyMismatch: The answer is no action chunk.
        """
        black = {camera: np.zeros((image_size, image_size, 3), np.uint8) for camera in cameras}
        observation = {"images": black, "proprioception": np.zeros(PROPRIOCEPTION_DIM), "instruction": instruction}
        try:
            inspect.signature(self._target).bind(**observation)
            answer = self._target(**observation)
            shape = np.shape(answer)
        except Exception:  # a class, a policy of the contract, or a function that needs something to see
            return
        if len(shape) == 2 and shape[0] and shape[1] == ACTION_DIM:
            return
        try:
            check_chunk(answer)
        except PolicyMismatch as error:
            raise PolicyMismatch(f"policy '{self.name}': {error}") from None


def _digest(target: Any, identity: str | None) -> str:
    """The hash of the object's content."""
    if identity is None and (source := _own_source(target)) is not None:
        return content_hash({"policy": "function", "source": source})
    return content_hash({"policy": "object", "identity": identity or uuid.uuid4().hex})


def _own_source(target: Any) -> str | None:
    """The source of a function whose answers depend on nothing else than modules, or None."""
    if not inspect.isfunction(target) or target.__name__ == "<lambda>":  # several lambdas may share a line
        return None
    if target.__closure__ or target.__defaults__ or target.__kwdefaults__ or hasattr(target, "__wrapped__"):
        return None
    known = target.__globals__
    if any(name in known and not isinstance(known[name], ModuleType) for name in _names(target.__code__)):
        return None
    try:
        return textwrap.dedent(inspect.getsource(target))
    except (OSError, TypeError):
        return None


def _names(code: CodeType) -> Iterator[str]:
    """Names of globals and attributes that the code uses, those of functions within it too."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)
