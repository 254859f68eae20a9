"""Runs a function in a process of its own, which ends with everything that code of the user has started there."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Mapping
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from typing import Any, TypeVar

from robogauntlet.adapters.contract import AdapterError
from robogauntlet.policies.contract import PolicyError
from robogauntlet.support.errors import UserError, describe
from robogauntlet.support.secret_variables import playing_variables

Result = TypeVar("Result")


class ProcessEnded(PolicyError):
    """The process ended before the function did."""


def run_apart(function: Callable[..., Result], *arguments: Any) -> Result:
    """Return what a function returns in another process; it prints to this one's standard error.

    Raises:
        ProcessEnded: The process ended before the function did.
        UserError, AdapterError: The function raised it, or something else, which is then a PolicyError.
    """
    context = get_context("spawn")
    receiving, sending = context.Pipe(duplex=False)
    environment = playing_variables(os.environ)
    process = context.Process(target=_answer, args=(sending, environment, function, arguments))
    process.start()
    sending.close()
    try:
        wait([receiving, process.sentinel])  # a process that it has forked may hold the pipe open
        if not receiving.poll():
            raise ProcessEnded("the policy ended its process")
        succeeded, answer = receiving.recv()
    except EOFError:
        raise ProcessEnded("the policy ended its process") from None
    finally:
        receiving.close()
        process.kill()
        process.join()
    if not succeeded:
        raise answer
    result: Result = answer
    return result


def _answer(
    sending: Connection, environment: Mapping[str, str], function: Callable[..., Any], arguments: tuple[Any, ...]
) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the command decides
    os.dup2(2, 1)
    os.environ.clear()
    os.environ.update(environment)
    try:
        answer: tuple[bool, Any] = True, function(*arguments)
    except (UserError, AdapterError) as error:
        answer = False, error if type(error).__module__.startswith("robogauntlet.") else PolicyError(str(error))
    except BaseException as error:  # code of the user raises anything
        answer = False, PolicyError(f"it raised {describe(error)}")
    sending.send(answer)
    sys.stderr.flush()
    os._exit(0)  # whatever threads the code has started
