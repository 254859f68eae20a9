"""A connection in vla-evaluation-harness' protocol, see `policies.remote.vla_eval_messages`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robogauntlet.adapters.catalog import body_of
from robogauntlet.adapters.contract import FloatArray
from robogauntlet.orchestrator.inference.session import Session, line_of
from robogauntlet.orchestrator.inference.shared_policy import HORIZON, SharedPolicy
from robogauntlet.policies.contract import check_chunk
from robogauntlet.policies.remote.msgpack_numpy import PackingError, pack
from robogauntlet.policies.remote.vla_eval_messages import Kind, check_version, hello_frame, message_of
from robogauntlet.policies.remote.vla_eval_server import OWN, native_action, query_of, specs_of, task_and_convention
from robogauntlet.suites.episode import Protocol

MAX_SEED = 2**31
NOT_BEGUN = f"expected {Kind.EPISODE_START} before the first observation, got none"


class VlaEvalSession(Session):
    """The state of one connection, which has one episode at a time. The rest of its chunk is kept here."""

    PING_S = None  # a benchmark builds its simulator in the thread that would answer

    def __init__(self, policy: SharedPolicy) -> None:
        """A connection without an episode. Raises PolicyMismatch, see `specs_of`."""
        super().__init__(policy)
        served = policy.served
        self._specs = specs_of(served.policy.spec, served.policy.spec.action_dim or body_of(served.task).action_dim)
        self._replan_every = max(served.execute or 0, Protocol(HORIZON).replan_every)  # as in a run
        self._benchmark = ""
        self._convention = OWN
        self._chunk: list[FloatArray] = []
        """Actions of the last chunk that are not sent yet."""
        self._step = 0
        self._reason = NOT_BEGUN
        """Why there is no episode."""

    async def decide(self, message: dict[str, Any]) -> bytes | None:
        """Return the answer to a HELLO or an observation."""
        kind, payload, number = message.get("type"), message.get("payload"), _number(message)
        if kind not in list(Kind) or not isinstance(payload, dict):
            shown = f"'{str(kind)[:40]}' with {type(payload).__name__}"
            raise PackingError(f"expected a message {', '.join(Kind)} with a mapping as payload, got {shown}")
        match kind:
            case Kind.HELLO:
                check_version(payload, "client")
                self._benchmark = str(payload.get("benchmark") or "")[:200]
                served = self._policy.served
                return hello_frame(
                    number, model_server="robogauntlet", policy=served.name, digest=served.digest, **self._specs
                )
            case Kind.EPISODE_START | Kind.EPISODE_END:
                await self._turn(payload if kind == Kind.EPISODE_START else None)
            case Kind.OBSERVATION:
                action = native_action(self._convention, await self._next_action(payload))
                return pack(message_of(Kind.ACTION, {"actions": action}, number))
        return None

    def refusal(self, line: str, message: dict[str, Any]) -> bytes:
        """Return the line as a message ERROR."""
        return pack(message_of(Kind.ERROR, {"error": line}, _number(message)))

    async def _turn(self, start: Mapping[str, Any] | None) -> None:
        """End the episode and start another, if there is one. Nobody waits for an answer: an observation gets it."""
        self._chunk, self._step, self._reason = [], 0, NOT_BEGUN
        try:
            await self.leave()
            if start is not None:
                await self._begin(start)
        except Exception as error:
            self._reason = line_of(error)

    async def _begin(self, start: Mapping[str, Any]) -> None:
        task = start.get("task")
        if not isinstance(task, dict):
            raise PackingError(f"expected a task as a mapping in {Kind.EPISODE_START}, got {type(task).__name__}")
        name, self._convention = task_and_convention(task, self._benchmark)
        number = task.get("episode_idx")
        seed = number if type(number) is int and 0 <= number < MAX_SEED else 0
        episode = self._policy.free_episode(seed, self._replan_every, name)
        await self._policy.begin(self, episode)
        self._episodes[episode.id] = episode

    async def _next_action(self, payload: Mapping[str, Any]) -> FloatArray:
        """Return the next action of the chunk, (numbers of an action,). Another is asked for when it is used up."""
        if not self._episodes:
            raise PackingError(self._reason)
        if not self._chunk:
            (episode,) = self._episodes.values()
            query = query_of(payload, episode, self._step, self._policy.served.policy.spec, self._convention)
            decision = await self._policy.ask(query)
            self._chunk = list(check_chunk(decision.actions, query.action_dim)[: episode.protocol.replan_every])
        self._step += 1
        return self._chunk.pop(0)


def _number(message: Mapping[str, Any]) -> int:
    number = message.get("seq")
    return number if type(number) is int and 0 <= number < 2**63 else 0
