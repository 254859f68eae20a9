"""No-skill baselines: policies whose success rates show what chance achieves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from robogauntlet.adapters.catalog import body_of
from robogauntlet.adapters.contract import ACTION_DIM, FloatArray
from robogauntlet.policies.contract import (
    Decision,
    PolicyInput,
    PolicyKind,
    PolicyMismatch,
    PolicySpec,
    Query,
    StatelessPolicy,
)
from robogauntlet.policies.digests import digest_of

CHUNK_LENGTH = 8
SCALE = np.array([0.02] * 3 + [0.05] * 3 + [1.0])
"""Of the actions of an arm whose tool is moved, for each step (m, rad), about that of the oracles."""
SOURCE = "5ceefc4e31b1c704"
"""In place of a hash of this file in the policies' digests: another one whenever another action comes of a query."""


def generator_for(query: Query) -> np.random.Generator:
    """Return a random generator that depends only on the episode and the step."""
    return np.random.default_rng([int(query.episode.id, 16), query.step])


def _numbers(query: Query) -> int:
    return query.action_dim if query.action_spec is None else len(query.action_spec.high)


def _scaled(unit: FloatArray, query: Query) -> FloatArray:
    """Scale numbers of -1 to 1, (n, numbers of an action): by `SCALE` for each arm, or to the limits of others.

    Raises:
        PolicyMismatch: An action is of other numbers than an arm's, whose limits the query does not tell, or without.
    """
    spec = query.action_spec
    if spec is not None and (spec.joints or spec.numbers):
        if not np.isfinite(spec.steps).all():
            raise PolicyMismatch(
                f"expected numbers within bounds to draw from, those of {query.episode.task} have none"
            )
        return np.asarray(spec.low + (unit + 1.0) / 2.0 * (spec.high - spec.low))
    seen = query.observation
    body = body_of(query.episode.task)
    if spec is None and ((seen.of_joints or seen.native) if seen else (body.joints or body.native)):
        raise PolicyMismatch(
            "expected the limits of actions, which a policy server is not told; run the policy by name"
        )
    return unit * np.tile(SCALE, unit.shape[1] // ACTION_DIM)


class ZeroPolicy(StatelessPolicy):
    """Stands still with open grippers."""

    spec = PolicySpec(PolicyInput.NOTHING, CHUNK_LENGTH, action_dim=None)

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """Return chunks without motion, of an arm whose tool is moved if the query does not tell what that is."""
        still = np.append(np.zeros(ACTION_DIM - 1), -1.0)
        return [Decision(np.tile(still if q.still is None else q.still, (CHUNK_LENGTH, 1))) for q in queries]


class RandomPolicy(StatelessPolicy):
    """Draws every action uniformly: motions of the tool, or others within their limits."""

    spec = PolicySpec(PolicyInput.NOTHING, CHUNK_LENGTH, action_dim=None)

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """Return chunks of uniform actions, keyed by episode and step."""
        return [Decision(_scaled(self._drawn(query), query)) for query in queries]

    def _drawn(self, query: Query) -> FloatArray:
        return generator_for(query).uniform(-1.0, 1.0, (CHUNK_LENGTH, _numbers(query)))


class UntrainedPolicy(StatelessPolicy):
    """An untrained network: a fixed random projection of images and proprioception.

    Its actions depend on every pixel and need rendering. It is the no-skill baseline of visual policies and exercises
    the whole path that a trained one takes.
    """

    GRID = 12
    spec = PolicySpec(PolicyInput.OBSERVATION, CHUNK_LENGTH, action_dim=None)

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """Return the tanh of a random projection of block-averaged images and proprioception."""
        return [Decision(_scaled(self._project(query), query)) for query in queries]

    def _project(self, query: Query) -> FloatArray:
        assert query.observation is not None
        parts = [self._blocks(image) for image in query.observation.images.values()]
        features = np.concatenate([*parts, query.observation.proprioception])
        weights = np.random.default_rng(0).normal(size=(CHUNK_LENGTH * _numbers(query), len(features)))
        return np.tanh(weights @ features / np.sqrt(len(features)) * 2.0).reshape(CHUNK_LENGTH, -1)

    def _blocks(self, image: np.ndarray) -> FloatArray:
        """Mean brightness of each cell of a grid, about -1 .. 1."""
        size = image.shape[0] // self.GRID * self.GRID
        blocks = image[:size, :size].reshape(self.GRID, size // self.GRID, self.GRID, size // self.GRID, 3)
        return blocks.mean(axis=(1, 3), dtype=np.float64).ravel() / 127.5 - 1.0


def _kind(name: str, summary: str, policy: type[ZeroPolicy] | type[RandomPolicy] | type[UntrainedPolicy]) -> PolicyKind:
    def load(options: Mapping[str, Any]) -> ZeroPolicy | RandomPolicy | UntrainedPolicy:
        return policy()

    return PolicyKind(name, summary, load, partial(digest_of, name, SOURCE), no_skill=True)


ZERO = _kind("zero", "stands still", ZeroPolicy)
RANDOM = _kind("random", "uniform random actions", RandomPolicy)
UNTRAINED = _kind("untrained", "an untrained network that looks at every pixel", UntrainedPolicy)
