"""Functions, and objects that can be called like them, as policies.

A function has parameters named `images, proprioception, instruction` and returns an action chunk. An object with such a
`__call__` may have `reset()`, which is called at the start of each episode.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from keyword import iskeyword
from typing import Any

from robogauntlet.adapters.contract import FloatArray, Observation
from robogauntlet.policies.contract import (
    Decision,
    Policy,
    PolicyError,
    PolicyInput,
    PolicySpec,
    Query,
    StatelessPolicy,
    check_chunk,
)
from robogauntlet.suites.episode import Episode
from robogauntlet.support.errors import describe

PARAMETERS = ("images", "proprioception", "instruction")
"""Parameters of a function: camera to (size, size, 3) uint8, (8,) or as the task has, float64, and text."""
MAX_CHUNK_LENGTH = 1000
CONTRACT = "robogauntlet.policies.contract"
LIST = ", ".join(PARAMETERS)
Act = Callable[..., FloatArray]


class FunctionPolicy(StatelessPolicy):
    """A plain function of the observation; `name` is for messages."""

    spec = PolicySpec(PolicyInput.OBSERVATION, MAX_CHUNK_LENGTH, action_dim=None)

    def __init__(self, act: Act, name: str) -> None:
        self._act, self._name = act, name

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """Call the function for each query. Raises PolicyError if the result is not a chunk."""
        return [_answer(self._act, query, self._name) for query in queries]

    def ask(self, observation: Observation) -> Any:
        """Return what the function returns, whatever it is."""
        return _call(self._act, observation)


class StatefulFunctionPolicy:
    """Objects with `__call__` and `reset`, one for each simultaneous episode; `name` is for messages.

    An object plays one episode at a time, so that episodes cannot share its state. Its `reset()` is called at the start
    of each.
    """

    spec = PolicySpec(PolicyInput.OBSERVATION, MAX_CHUNK_LENGTH, action_dim=None)

    def __init__(self, first: Any, build: Callable[[], Any], name: str) -> None:
        """Take an object, and a function that makes further ones for episodes that are played at the same time."""
        self._build, self._name = build, name
        self._idle = [first]
        self._playing: dict[str, Any] = {}
        """Episode id to the object that plays it."""

    def reset(self, episodes: Sequence[Episode]) -> None:
        """Give each episode an object of its own, and reset it.

        Raises:
            PolicyError: There is no further object for a simultaneous episode.
        """
        for episode in episodes:
            if episode.id not in self._playing:
                self._playing[episode.id] = self._idle.pop() if self._idle else self._another()
            try:
                self._playing[episode.id].reset()
            except Exception:
                self.finish([episode])
                raise

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """Call the object of each query's episode. Raises PolicyError if the result is not a chunk."""
        return [_answer(self._playing[query.episode.id], query, self._name) for query in queries]

    def ask(self, observation: Observation) -> Any:
        """Return what an object returns at the start of an episode, whatever it is."""
        self._idle[-1].reset()
        return _call(self._idle[-1], observation)

    def finish(self, episodes: Sequence[Episode]) -> None:
        """Free the objects of these episodes for others."""
        self._idle += [self._playing.pop(episode.id) for episode in episodes if episode.id in self._playing]

    def _another(self) -> Any:
        try:
            other = self._build()
        except Exception as error:  # it may raise anything
            raise PolicyError(f"{self._name}: building it once more raised {describe(error)}") from None
        if any(other is one for one in self._playing.values()):
            raise PolicyError(
                f"{self._name}: expected an object for each simultaneous episode, since it has reset; got the same "
                "one twice; name its class instead, or play with inference: worker"
            )
        return other


def _call(act: Act, observation: Observation) -> Any:
    return act(**{parameter: getattr(observation, parameter) for parameter in PARAMETERS})


def _answer(act: Act, query: Query, name: str) -> Decision:
    assert query.observation is not None
    try:
        return Decision(check_chunk(_call(act, query.observation), query.action_dim))
    except PolicyError as error:
        raise type(error)(f"{name}: {error}") from None


def as_policy(target: Callable[..., Any], options: Mapping[str, Any], text: str) -> Policy:
    """Return the policy that a function, a class or a factory makes with these keyword arguments.

    Args:
        target: A function of the observation, or a class or factory of such a function or of a policy.
        options: Keyword arguments.
        text: The target's name, such as `module:Name`, for messages.

    Raises:
        PolicyError: It makes none; the message says what to write.
    """
    name = text.rpartition(":")[2]
    wanted = f"write def {name if name.isidentifier() and not iskeyword(name) else 'act'}({LIST})"
    if is_plain(target):
        try:
            inspect.signature(target).bind(**dict.fromkeys(PARAMETERS), **options)
        except TypeError as error:
            raise PolicyError(f"policy '{text}': options do not fit the function: {error}") from None
        return _of_callable(target, lambda: target, options, text)
    if inspect.isroutine(target) and (missing := _required(target) - options.keys()):
        raise PolicyError(
            f"policy '{text}': expected parameters named {LIST}, or a factory without required ones; "
            f"found {name}{_signature(target)}, which needs {', '.join(sorted(missing))}; {wanted}"
        )
    if inspect.isroutine(target) and not options and _takes_any_names_only(target):
        raise PolicyError(f"policy '{text}': found {name}{_signature(target)}; {wanted}")
    build = partial(target, **options)
    try:
        made: Any = build()
    except Exception as error:  # it may raise anything
        raise PolicyError(f"policy '{text}': building it raised {describe(error)}") from None
    if is_contract(made):
        return _checked(made, text)
    if not callable(made):
        raise PolicyError(
            f"policy '{text}': expected a function of {LIST}, or a class with __call__(self, {LIST}), and with "
            f"reset(self) if it keeps state; got {type(made).__name__} without __call__"
        )
    if not _accepts_observation(made):
        raise PolicyError(
            f"policy '{text}': expected __call__(self, {LIST}), found __call__{_signature(made, of_object=True)}; "
            "use these names"
        )
    return _of_callable(made, build, {}, text)


def _of_callable(first: Any, build: Callable[[], Any], options: Mapping[str, Any], text: str) -> Policy:
    """The policy of an object that accepts the observation and the options."""
    name, reset = text.rpartition(":")[2], getattr(first, "reset", None)
    if not callable(reset):
        return FunctionPolicy(partial(first, **options), name)
    if _required(reset):
        raise PolicyError(
            f"policy '{text}': expected reset(self) without further parameters, which is called at the start of each "
            f"episode; found reset{_signature(reset, of_object=True)}"
        )
    if options:
        raise PolicyError(f"policy '{text}': expected no options for an object with reset, got {', '.join(options)}")
    return StatefulFunctionPolicy(first, build, name)


def _checked(policy: Any, text: str) -> Policy:
    if not _binds(policy.act, []):
        raise PolicyError(
            f"policy '{text}': expected act(self, queries) of {CONTRACT}.Policy, found "
            f"act{_signature(policy.act, of_object=True)}; write __call__(self, {LIST}) instead of act"
        )
    for name in ("reset", "finish"):
        if not callable(getattr(policy, name, None)):
            raise PolicyError(
                f"policy '{text}': expected methods reset, act and finish of {CONTRACT}.Policy, found no {name}; or "
                f"write __call__(self, {LIST}) and reset(self) instead of act"
            )
    if not isinstance(getattr(policy, "spec", None), PolicySpec):
        raise PolicyError(f"policy '{text}': expected attribute spec, a {CONTRACT}.PolicySpec; got none")
    return policy


def is_contract(made: Any) -> bool:
    """Whether an object is meant as a policy of the contract; a callable one may have something else called `act`."""
    return callable(getattr(made, "act", None)) and (
        isinstance(getattr(made, "spec", None), PolicySpec) or not callable(made)
    )


def is_plain(target: Any) -> bool:
    """Whether the target itself is a function of the observation."""
    if inspect.isclass(target):
        return False
    try:
        parameters = inspect.signature(target).parameters
    except (TypeError, ValueError):
        return False
    return all(name in parameters for name in PARAMETERS)


def _takes_any_names_only(target: Any) -> bool:
    """Whether it is a function of `**observation`, which cannot be told from a factory with options."""
    try:
        parameters = inspect.signature(target).parameters.values()
    except (TypeError, ValueError):
        return False
    return [parameter.kind for parameter in parameters] == [inspect.Parameter.VAR_KEYWORD]


def _accepts_observation(made: Any) -> bool:
    return _binds(made, **dict.fromkeys(PARAMETERS))


def _binds(function: Any, *positional: Any, **named: Any) -> bool:
    """Whether a function can be called with these arguments."""
    try:
        inspect.signature(function).bind(*positional, **named)
    except TypeError:
        return False
    except ValueError:  # compiled code has no signature; the first query shows
        return True
    return True


def _required(function: Any) -> set[str]:
    """Names of the parameters that have no default."""
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return set()
    return {p.name for p in parameters if p.default is p.empty and p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)}


def _signature(function: Any, *, of_object: bool = False) -> str:
    try:
        names = ["self"] * of_object + [str(p) for p in inspect.signature(function).parameters.values()]
    except (TypeError, ValueError):
        return "(...)"
    return f"({', '.join(names)})"
