"""Plays a policy in a process of its own, which ends with everything that code of the user has started there."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Mapping
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from typing import Any, TypeVar

from robogauntlet.adapters.contract import AdapterError
from robogauntlet.orchestrator.episodes.policy_source import PolicySource, build_policy
from robogauntlet.orchestrator.inference.planned_policy import LOADING_S
from robogauntlet.policies.contract import Policy, PolicyError
from robogauntlet.support.errors import UserError, describe
from robogauntlet.support.secret_variables import playing_variables

Result = TypeVar("Result")


class ProcessEnded(PolicyError):
    """The process ended before the function did."""


def run_apart(function: Callable[..., Result], source: PolicySource, *arguments: Any) -> Result:
    """Return what a function of a policy returns in another process; it prints to this one's standard error.

    Args:
        function: Gets the policy and the arguments; it limits its own time.
        source: The policy, which is built in the process.
        arguments: The further arguments.

    Raises:
        ProcessEnded: The process ended before the function did.
        PolicyError: The policy was not built within `LOADING_S`.
        UserError, AdapterError: The function raised it, or something else, which is then a PolicyError.
    """
    context = get_context("spawn")
    receiving, sending = context.Pipe(duplex=False)
    environment = playing_variables(os.environ)
    process = context.Process(target=_answer, args=(sending, environment, function, source, arguments))
    process.start()
    sending.close()
    try:
        for limit_s in (LOADING_S, None):  # until the policy is built, and until the function has ended
            # Besides the pipe, since a process that it has forked may hold that open.
            if not wait([receiving, process.sentinel], limit_s):
                raise PolicyError(
                    f"expected the policy to be built within {limit_s:g} s, got none; find out where it hangs"
                )
            if not receiving.poll():
                raise ProcessEnded("the policy ended its process")
            succeeded, answer = receiving.recv()
            if not succeeded:
                raise answer
    except EOFError:
        raise ProcessEnded("the policy ended its process") from None
    finally:
        receiving.close()
        process.kill()
        process.join()
    result: Result = answer
    return result


def close_policy(policy: Policy) -> None:
    """Close it, if it has something to close."""
    if callable(close := getattr(policy, "close", None)):
        close()


def _answer(
    sending: Connection,
    environment: Mapping[str, str],
    function: Callable[..., Any],
    source: PolicySource,
    arguments: tuple[Any, ...],
) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the command decides
    os.dup2(2, 1)
    os.environ.clear()
    os.environ.update(environment)
    try:
        policy = build_policy(source)
        try:
            sending.send((True, None))
            answer: tuple[bool, Any] = True, function(policy, *arguments)
        finally:
            close_policy(policy)
    except (UserError, AdapterError) as error:
        answer = False, error if type(error).__module__.startswith("robogauntlet.") else PolicyError(str(error))
    except BaseException as error:  # code of the user raises anything
        answer = False, PolicyError(f"it raised {describe(error)}")
    sending.send(answer)
    sys.stderr.flush()
    os._exit(0)  # whatever threads the code has started
