"""Asks a function once, about black images, before anything is started."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import TimeoutError as Late
from typing import Any

from robogauntlet.adapters.contract import Observation, TaskDescription, black_observation
from robogauntlet.orchestrator.inference.daemon_thread import DaemonThread
from robogauntlet.policies.contract import PolicyError, PolicyMismatch, chunk_of
from robogauntlet.suites.episode import View

LIMIT_S = 120.0
"""Time for the first answer (s), in which a policy may load its weights."""


class _Left(Exception):
    """The policy raised what ends a process."""


def check_first_answer(name: str, ask: Callable[[Observation], Any], view: View, task: TaskDescription) -> None:
    """Refuse a policy whose answer to black images has a wrong shape, or is late. It may raise, as one that must see.

    Args:
        name: The policy's name, for messages.
        ask: Returns the answer to an observation.
        view: Cameras and size of the images.
        task: The task, with its instruction and what acts in it.

    Raises:
        PolicyMismatch: The answer is no action chunk.
        PolicyError: There is none within `LIMIT_S`.
    """
    observation = black_observation(view, task.body, task.instruction)

    def asked() -> Any:
        try:
            return ask(observation)
        except (SystemExit, KeyboardInterrupt) as left:  # raised there, it is the policy's and nobody's at a keyboard
            raise _Left(type(left).__name__) from None

    try:
        answer = call_within(LIMIT_S, asked)
    except Late:
        raise PolicyError(
            f"policy '{name}': expected its first answer within {LIMIT_S:g} s, got none; serve a policy that takes "
            "longer (robogauntlet serve policy), or find out where it hangs"
        ) from None
    except _Left as left:
        raise PolicyError(f"policy '{name}': expected an action chunk, it ended its process ({left})") from None
    except Exception:
        return
    try:
        chunk_of(answer, observation.action_dim)
    except PolicyMismatch as error:
        raise PolicyMismatch(f"policy '{name}': {error}") from None


def call_within(seconds: float, function: Callable[[], Any]) -> Any:
    """Return what a function returns, or raise what it raises.

    Raises:
        concurrent.futures.TimeoutError: It takes longer (s). It goes on in a thread that keeps no process from ending.
    """
    thread = DaemonThread()
    called = thread.submit(function)
    thread.shutdown(wait=False)
    try:
        return called.result(seconds)
    except Late:
        if called.done():  # the function itself raised TimeoutError
            raise RuntimeError("the function timed out") from None
        raise
