"""A policy of the user's code while a run is planned: in a process of its own, which imports it and is asked about it.

Whatever the code does there (threads that never end, another working directory, a crash), the command goes on.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from contextlib import closing
from dataclasses import asdict
from typing import Any

from pydantic import TypeAdapter, ValidationError
from pydantic_core import to_jsonable_python

from robogauntlet.adapters.contract import TaskDescription
from robogauntlet.orchestrator.episodes.policy_source import PolicySource, build_policy
from robogauntlet.orchestrator.inference.first_answer import LIMIT_S, check_first_answer
from robogauntlet.policies import catalog
from robogauntlet.policies.contract import (
    Policy,
    PolicyError,
    PolicyMismatch,
    PolicyNotInstalled,
    PolicySpec,
    PolicyUnreachable,
)
from robogauntlet.policies.function_policy import FunctionPolicy, StatefulFunctionPolicy
from robogauntlet.policies.stored import first_fault
from robogauntlet.suites.episode import View
from robogauntlet.support.child_process import ChildEnded, ChildTimeout, JsonChild, serve
from robogauntlet.support.errors import describe
from robogauntlet.support.secret_variables import playing_variables

LOADING_S = 600.0
"""Time in which a policy is imported and built (s)."""
LONGEST_CHUNK = 1_000_000
_ERRORS = {kind.__name__: kind for kind in (PolicyError, PolicyMismatch, PolicyNotInstalled, PolicyUnreachable)}
_SPEC = TypeAdapter(PolicySpec)


class PlannedPolicy:
    """A policy in a process of its own. Close it."""

    def __init__(self, name: str, source: PolicySource) -> None:
        """Import and build it.

        Raises:
            PolicyError: It cannot be built, its process ended, or took too long.
        """
        self._name = name
        command = [sys.executable, "-P", "-m", "robogauntlet.orchestrator.inference.planned_policy"]
        environment = {**playing_variables(os.environ), **(source.variables or {})}
        self._process = JsonChild(command, environment=environment, own_group=True)
        try:
            request = {"name": name, "kind": source.kind, "options": source.options, "path": sys.path}
            plain = self._ask(request, LOADING_S, "to be imported and built")
            try:
                self.spec = _SPEC.validate_python(plain)
            except ValidationError as error:
                raise PolicyError(f"policy '{name}': expected a spec of the contract: {first_fault(error)}") from None
            if not 1 <= self.spec.chunk_length <= LONGEST_CHUNK:
                raise PolicyError(
                    f"policy '{name}': expected chunks of 1 to {LONGEST_CHUNK:,} actions in its spec, got "
                    f"{self.spec.chunk_length:,}"
                )
        except BaseException:
            self.close()
            raise

    def check_answer(self, view: View, task: TaskDescription) -> None:
        """Ask a function once, see `check_first_answer`; nothing of another policy. Raises PolicyError."""
        seen = {"cameras": view.cameras, "image_size": view.image_size, "instruction": task.instruction}
        request = {**seen, "body": asdict(task.body)}
        self._ask(request, LIMIT_S + 10.0, "its first answer")  # the process itself says what is late

    def close(self) -> None:
        """Kill the process."""
        self._process.close()

    def _ask(self, request: Mapping[str, Any], limit_s: float, what: str) -> Any:
        try:
            answer = self._process.ask(request, limit_s)
        except ChildTimeout:
            raise PolicyError(
                f"policy '{self._name}': expected {what} within {limit_s:g} s, got none; find out where it hangs"
            ) from None
        except ChildEnded as error:
            raise PolicyError(f"policy '{self._name}': expected {what}, {error}") from None
        if "error" in answer:
            kind, message = answer["error"]
            raise _ERRORS.get(kind, PolicyError)(message)
        return answer["spec"]


def planned_spec(name: str, source: PolicySource) -> PolicySpec:
    """Return a policy's spec; code of the user is imported in another process. Raises PolicyError."""
    if not catalog.find(source.kind).imports_code:
        return catalog.spec(source.kind, source.options)
    with closing(PlannedPolicy(name, source)) as policy:
        return policy.spec


class _Asked:
    """The policy in its process."""

    policy: Policy | None = None
    name = ""

    def answer(self, request: Mapping[str, Any]) -> dict[str, Any]:
        try:
            if "kind" in request:
                self.name = request["name"]
                sys.path[:] = request["path"]
                self.policy = build_policy(PolicySource(request["kind"], request["options"]))
                spec = PolicySpec(**_fields(self.policy.spec))
                return {"spec": to_jsonable_python(spec, fallback=str)}  # numbers of numpy as digits
            if isinstance(self.policy, FunctionPolicy | StatefulFunctionPolicy):
                view = View(tuple(request["cameras"]), request["image_size"])
                body: dict[str, Any] = {
                    name: tuple(own) if isinstance(own, list) else own for name, own in request["body"].items()
                }
                task = TaskDescription(request["instruction"], 1, **body)
                check_first_answer(self.name, self.policy.ask, view, task)
            return {"spec": None}
        except PolicyError as error:
            return {"error": [type(error).__name__, str(error)]}
        except BaseException as error:  # code of the user raises anything, and would end this process
            return {"error": ["PolicyError", f"policy '{self.name}': loading it raised {describe(error)}"]}


def _fields(spec: PolicySpec) -> dict[str, Any]:
    return {name: value for name, value in asdict(spec).items() if name in PolicySpec.__dataclass_fields__}


if __name__ == "__main__":
    serve(_Asked().answer)
    os._exit(0)  # whatever threads the code has started
