"""A policy, a query for it and an answer, as messages have them."""

import numpy as np

from robogauntlet.adapters.contract import Observation
from robogauntlet.policies.contract import Decision, Policy, PolicyInput, PolicySpec, Query, Routing
from robogauntlet.policies.remote.protocol import as_answer
from robogauntlet.suites.episode import Episode, Protocol

SIZE = 2
SPEC = PolicySpec(PolicyInput.OBSERVATION, chunk_length=4, cameras=("third_person", "wrist"), image_size=SIZE)


class _Policy(Policy):
    spec = SPEC

    def act(self, queries):
        return []


POLICY = _Policy()
_IMAGE = np.arange(SIZE * SIZE * 3, dtype=np.uint8).reshape(SIZE, SIZE, 3)
QUERY = Query(
    Episode("p", "0123456789abcdef", "null/Reach", 3, Protocol(60)),
    step=8,
    observation=Observation({"third_person": _IMAGE, "wrist": _IMAGE}, np.arange(8.0), "reach the ball"),
)
ANSWER = as_answer(Decision(np.ones((4, 8)) / 2, Routing({"null/Reach": -0.1, "null/Slow": -2.3}, "null/Reach", 0.01)))
