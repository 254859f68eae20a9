"""Defects planted into the shipped experts: late actions, mirrored images, a gripper that is the wrong way round.

The suite names `Defective` as a policy of the kind `python`. It wraps the kind `mergevla-experts` by its entry point,
as any policy can be wrapped.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import replace
from importlib.metadata import entry_points

import numpy as np

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.policies.contract import Decision, Policy, Query
from robogauntlet.suites.episode import Episode

KIND, FOLDER = "mergevla-experts", "zoo:experts"
OPEN = -1.0


class Defective:
    """The experts with defects; without any, their actions are the experts' own.

    Args:
        delay: Control steps by which each action comes late. Until the first comes, the tool stays where it is, with an
            open gripper.
        mirrored: Cameras whose images are mirrored left-right.
        flipped: Share of the episodes, drawn by task and seed, in which the gripper opens where it should close.
        forgets: Whether an episode begins without the actions that were still to come in the one before.
        unit: Length (m) that a translation of 1 stands for.
    """

    def __init__(
        self,
        delay: int = 0,
        mirrored: Sequence[str] = (),
        flipped: float = 0.0,
        forgets: bool = True,
        unit: float = 1.0,
    ) -> None:
        (entry,) = entry_points(group="robogauntlet.policies", name=KIND)
        self._experts: Policy = entry.load().load({"folder": FOLDER})
        self.spec = self._experts.spec
        self._delay, self._mirrored, self._flipped = delay, mirrored, flipped
        self._forgets, self._unit = forgets, unit
        self._late: dict[str, FloatArray] = {}
        """Actions that are still to come, by episode; of a policy that does not forget, of all together."""

    def reset(self, episodes: Sequence[Episode]) -> None:
        """Start episodes."""
        self._experts.reset(episodes)

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """Ask the experts, and spoil what they see and what they answer."""
        answers = self._experts.act([self._seen(query) for query in queries])
        pairs = zip(queries, answers, strict=True)
        return [Decision(self._spoil(query.episode, answer.actions)) for query, answer in pairs]

    def finish(self, episodes: Sequence[Episode]) -> None:
        """Drop the state of episodes."""
        self._experts.finish(episodes)
        for episode in episodes:
            self._late.pop(episode.id, None)

    def _seen(self, query: Query) -> Query:
        assert query.observation is not None
        images = dict(query.observation.images)
        images |= {camera: images[camera][:, ::-1].copy() for camera in self._mirrored}
        return replace(query, observation=replace(query.observation, images=images))

    def _spoil(self, episode: Episode, actions: FloatArray) -> FloatArray:
        numbers = actions.shape[1]
        actions = actions / ([self._unit] * 3 + [1.0] * (numbers - 3))
        if random.Random(f"{episode.task}/{episode.seed}").random() < self._flipped:
            actions[:, -1] *= -1
        still = np.tile([0.0] * (numbers - 1) + [OPEN], (self._delay, 1))
        key = episode.id if self._forgets else ""
        queue = np.concatenate([self._late.get(key, still), actions])
        self._late[key] = queue[len(actions) :]
        return queue[: len(actions)]
