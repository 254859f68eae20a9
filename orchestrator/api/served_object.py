"""Objects of the running process as policies of a run: they stay in it, and the workers ask it by a policy server."""

from __future__ import annotations

import dis
import inspect
import os
import secrets
import sysconfig
import textwrap
import uuid
from collections.abc import Iterator, Mapping
from importlib.util import find_spec
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

from robogauntlet.adapters.contract import TaskDescription
from robogauntlet.orchestrator.environments.resolver import OBJECT_TOKEN
from robogauntlet.orchestrator.inference.first_answer import check_first_answer
from robogauntlet.orchestrator.inference.server_thread import ServerThread
from robogauntlet.orchestrator.inference.shared_policy import IdentifiedPolicy
from robogauntlet.orchestrator.inference.websocket_server import ServerOptions
from robogauntlet.policies.function_policy import FunctionPolicy, StatefulFunctionPolicy, as_policy, is_contract
from robogauntlet.suites.episode import View, content_hash
from robogauntlet.suites.schema import PolicyEntry, valid_name

READERS = {"open", "exec", "eval", "load", "globals"}
"""Names by which a function reads what its source does not show."""
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
        token = os.environ.setdefault(OBJECT_TOKEN, secrets.token_urlsafe())
        super().__init__(
            IdentifiedPolicy(policy, self.name, _digest(target, identity)), ServerOptions(port=0, token=token)
        )

    @property
    def is_sequential(self) -> bool:
        """Whether it keeps the state of one episode, so that it plays one at a time."""
        is_policy = inspect.isclass(self._target) or is_contract(self._target)
        return not is_policy and callable(getattr(self._target, "reset", None))

    @property
    def entry(self) -> PolicyEntry:
        """The policy in a suite, while it is served."""
        return PolicyEntry(
            name=self.name,
            kind="openpi",
            options={"address": self.address, "timeout_s": TIMEOUT_S, "retries": 0, "token_variable": OBJECT_TOKEN},
        )

    def check_answer(self, view: View, task: TaskDescription) -> None:
        """Ask a function or object once, see `check_first_answer`. Of a class or factory, ask what it makes.

        Raises:
            PolicyError: See there.
        """
        if isinstance(policy := self.server.served.policy, FunctionPolicy | StatefulFunctionPolicy):
            check_first_answer(self.name, policy.ask, view, task)


def _digest(target: Any, identity: str | None) -> str:
    """The hash of the object's content."""
    if identity is None and (source := _own_source(target)) is not None:
        return content_hash({"policy": "function", "source": source, "code": list(_instructions(target.__code__))})
    return content_hash({"policy": "object", "identity": identity or uuid.uuid4().hex})


def _own_source(target: Any) -> str | None:
    """The source of a function whose answers depend on nothing else than installed modules, or None."""
    if not inspect.isfunction(target) or target.__name__ == "<lambda>":  # several lambdas may share a line
        return None
    if target.__closure__ or target.__defaults__ or target.__kwdefaults__ or hasattr(target, "__wrapped__"):
        return None
    if not all(map(_is_installed, _uses(target.__code__, target.__globals__))):
        return None
    try:
        return textwrap.dedent(inspect.getsource(target))
    except (OSError, TypeError):
        return None


def _uses(code: CodeType, known: Mapping[str, Any]) -> Iterator[str | None]:
    """Names of the modules that a function uses, and None for another global or a function that reads."""
    for part in _codes(code):
        for name in part.co_names:
            if name in READERS:
                yield None
            elif name in known:
                yield known[name].__name__ if isinstance(known[name], ModuleType) else None
        for instruction in dis.get_instructions(part):
            if instruction.opname == "IMPORT_NAME":
                yield str(instruction.argval)


def _is_installed(module: str | None) -> bool:
    """Whether it is a module of Python or of an installed distribution."""
    spec = None if module is None else find_spec(module.partition(".")[0])
    if spec is None or spec.origin is None:
        return False
    folders = (sysconfig.get_path(kind) for kind in ("stdlib", "purelib", "platlib"))
    return spec.origin in ("built-in", "frozen") or any(Path(spec.origin).is_relative_to(folder) for folder in folders)


def _codes(code: CodeType) -> Iterator[CodeType]:
    """The code and that of functions within it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _codes(constant)


def _instructions(code: CodeType) -> Iterator[str]:
    """What a function executes, whose file may have been changed since it was loaded."""
    for part in _codes(code):
        yield part.co_code.hex()
        yield repr([constant for constant in part.co_consts if not isinstance(constant, CodeType)])
