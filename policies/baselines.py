"""No-skill baselines: policies whose success rates show what chance achieves."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robogauntlet.adapters.contract import ACTION_DIM, FloatArray
from robogauntlet.policies.contract import Decision, PolicyInput, PolicyKind, PolicySpec, Query, StatelessPolicy
from robogauntlet.policies.digests import scripted_digest

CHUNK_LENGTH = 8
TRANSLATION, ROTATION = 0.02, 0.05
"""Scale of the actions per step (m, rad), about that of the oracles."""


def generator_for(query: Query) -> np.random.Generator:
    """Return a random generator that depends only on the episode and the step."""
    return np.random.default_rng([int(query.episode.id, 16), query.step])


def _scaled(unit: FloatArray) -> FloatArray:
    return unit * np.array([TRANSLATION] * 3 + [ROTATION] * 3 + [1.0])


class ZeroPolicy(StatelessPolicy):
    """Stands still with an open gripper."""

    spec = PolicySpec(PolicyInput.NOTHING, CHUNK_LENGTH)

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """Return chunks without motion."""
        chunk = np.zeros((CHUNK_LENGTH, ACTION_DIM))
        chunk[:, -1] = -1.0
        return [Decision(chunk) for _ in queries]


class RandomPolicy(StatelessPolicy):
    """Draws every action uniformly."""

    spec = PolicySpec(PolicyInput.NOTHING, CHUNK_LENGTH)

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """Return chunks of uniform actions, keyed by episode and step."""
        return [Decision(_scaled(generator_for(q).uniform(-1.0, 1.0, (CHUNK_LENGTH, ACTION_DIM)))) for q in queries]


class UntrainedPolicy(StatelessPolicy):
    """An untrained network: a fixed random projection of images and proprioception.

    Its actions depend on every pixel and need rendering. It is the no-skill baseline of visual policies and exercises
    the whole path that a trained one takes.
    """

    GRID = 12
    spec = PolicySpec(PolicyInput.OBSERVATION, CHUNK_LENGTH)

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """Return the tanh of a random projection of block-averaged images and proprioception."""
        return [Decision(_scaled(self._project(q).reshape(CHUNK_LENGTH, ACTION_DIM))) for q in queries]

    def _project(self, query: Query) -> FloatArray:
        assert query.observation is not None
        parts = [self._blocks(image) for image in query.observation.images.values()]
        features = np.concatenate([*parts, query.observation.proprioception])
        weights = np.random.default_rng(0).normal(size=(CHUNK_LENGTH * ACTION_DIM, len(features)))
        return np.tanh(weights @ features / np.sqrt(len(features)) * 2.0)

    def _blocks(self, image: np.ndarray) -> FloatArray:
        """Mean brightness of each cell of a grid, about -1 .. 1."""
        size = image.shape[0] // self.GRID * self.GRID
        blocks = image[:size, :size].reshape(self.GRID, size // self.GRID, self.GRID, size // self.GRID, 3)
        return blocks.mean(axis=(1, 3), dtype=np.float64).ravel() / 127.5 - 1.0


def _kind(name: str, summary: str, policy: type[ZeroPolicy] | type[RandomPolicy] | type[UntrainedPolicy]) -> PolicyKind:
    def load(options: Mapping[str, Any]) -> ZeroPolicy | RandomPolicy | UntrainedPolicy:
        return policy()

    return PolicyKind(name, summary, load, scripted_digest(name, sys.modules[__name__]), no_skill=True)


ZERO = _kind("zero", "stands still", ZeroPolicy)
RANDOM = _kind("random", "uniform random actions", RandomPolicy)
UNTRAINED = _kind("untrained", "an untrained network that looks at every pixel", UntrainedPolicy)
