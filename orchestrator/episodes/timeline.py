"""Which action the robot executes at each control step, while answers take simulated time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from robogauntlet.adapters.contract import GRIPPER, ActionSpec, FloatArray
from robogauntlet.orchestrator.perturbations.actions import delay_steps
from robogauntlet.orchestrator.perturbations.base import generator_for
from robogauntlet.suites.axes import AXES, LATENCY
from robogauntlet.suites.episode import Episode
from robogauntlet.suites.timing import Timing, TimingMode


@dataclass(frozen=True, slots=True)
class Segment:
    """The steps from one query to the next."""

    actions: FloatArray
    """Of shape (steps, numbers); those of held steps are not executed."""
    held: npt.NDArray[np.bool_]
    """Steps in which the robot has no action, of shape (steps,)."""
    stale: npt.NDArray[np.bool_]
    """Steps of the answer before, executed while this one took time, of shape (steps,)."""
    ages: npt.NDArray[np.int64]
    """Control steps since the observation behind each action, of shape (steps,)."""


class Timeline:
    """The steps of an episode, by what its protocol and its condition say of latency.

    The policy is asked again when as many steps have passed as the protocol says, or the answer is used up. A robot
    that continues asks earlier if the next answer, with the latency of this one, would come too late; it never awaits
    two answers. A latency is rounded to the nearest number of control steps, half a step
    up. A random one depends on the pair and the number of the query alone, so that policies meet the same.
    """

    def __init__(self, episode: Episode, spec: ActionSpec) -> None:
        self._timing: Timing | None = episode.protocol.timing
        self._replan_every, self._hz, self._key = episode.protocol.replan_every, spec.control_hz, episode.pair_id
        added = [(LATENCY[p.axis], p) for p in episode.condition.perturbations if p.axis in LATENCY]
        self._added_ms = sum(AXES[one.axis].value(one.severity) for _, one in added)
        self._mode = added[0][0] if added else self._timing.mode if self._timing is not None else None
        self._follows = np.array([name.endswith(GRIPPER) for name in spec.names])
        self._rest: FloatArray = np.zeros((0, len(spec.names)))
        """Actions of the last answer that are not executed yet."""
        self._queries = self._answered = self._last_length = 0
        self._held = self._stale = self._executed = self._age = 0

    def segment(self, chunk: FloatArray) -> Segment:
        """Return the steps until the policy is asked again.

        Args:
            chunk: What it answers now, of shape (n, numbers).
        """
        steps = self._latency_steps()
        is_blended = self._mode is TimingMode.BLEND and steps > 0
        continues = self._mode in (TimingMode.CONTINUE, TimingMode.BLEND)
        stale = self._rest[:steps] if continues else self._rest[:0]
        own = chunk[len(stale) :]
        if is_blended:
            own = self._blended(self._rest[steps:], own)
        share = self._replan_every
        if continues:  # the rest is for the time of the next answer
            share = max(min(share - steps, len(own) - steps), 0)
        self._rest, own = own[share:], own[:share]
        idle = np.zeros((steps - len(stale), chunk.shape[1]))
        lengths = len(stale), len(idle), len(own)
        kinds = np.repeat([1, 2, 0], lengths)
        ages = np.arange(sum(lengths)) + np.where(kinds == 1, self._last_length, 0)
        self._queries += 1
        self._answered += len(chunk)
        self._last_length = sum(lengths)
        return Segment(np.concatenate([stale, idle, own]), kinds == 2, kinds == 1, ages)

    def count(self, segment: Segment, steps: int) -> None:
        """Note that the first `steps` of a segment were executed."""
        held = segment.held[:steps]
        self._held += int(held.sum())
        self._stale += int(segment.stale[:steps].sum())
        self._executed += steps - int(held.sum())
        self._age += int(segment.ages[:steps][~held].sum())

    def columns(self) -> dict[str, Any]:
        """The fields of an `EpisodeResult` about waiting; none where the simulation waits for answers."""
        if self._mode is None:
            return {}
        age = self._age / self._executed / self._hz if self._executed else None
        share = self._executed / self._answered if self._answered else None
        return {
            "held_steps": self._held,
            "stale_steps": self._stale,
            "observation_age": None if age is None else round(age, 3),
            "chunk_share": None if share is None else round(share, 3),
        }

    def _latency_steps(self) -> int:
        latency_ms = self._added_ms
        if self._timing is not None:
            normal = (
                0.0 if self._timing.p95_ms is None else generator_for(self._key, self._queries, 1).standard_normal()
            )
            latency_ms += self._timing.latency_ms(normal)
        return delay_steps(latency_ms, self._hz, least=0)

    def _blended(self, old: FloatArray, new: FloatArray) -> FloatArray:
        """The new actions, the first of them averaged with the old ones of the same times."""
        both = min(len(old), len(new))
        share = np.arange(both, 0, -1)[:, None] / (both + 1)
        mixed = share * old[:both] + (1 - share) * new[:both]
        return np.concatenate([np.where(self._follows, new[:both], mixed), new[both:]])
