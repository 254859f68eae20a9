"""Networks in memory."""

import pytest
import torch

from robogauntlet_mergevla.network.model_cache import ModelCache

BASE = torch.zeros(1000)


class Builder:
    """Builds networks of 400 bytes beside the base, and counts how often."""

    def __init__(self, limit=None):
        self.built = []
        self.cache = ModelCache(self.build, lambda it: it, device=torch.device("cpu"), shared=[BASE], limit=limit)

    def build(self, key):
        self.built.append(key)
        return [BASE, torch.full((100,), float(key))]


@pytest.mark.parametrize("experts", [9, 17, 50])
def test_asking_for_one_after_the_other_builds_each_once_whatever_their_number(experts):
    made = Builder()
    for _ in range(3):
        for key in range(experts):
            assert made.cache(key)[1][0] == key
    assert made.built == list(range(experts))


def test_those_least_recently_used_are_dropped_when_memory_runs_short():
    made = Builder(limit=3 * 400)
    for key in (0, 1, 2, 0, 3, 0, 1):
        made.cache(key)
    assert made.built == [0, 1, 2, 3, 1]


def test_a_network_larger_than_all_memory_is_still_built():
    made = Builder(limit=1)
    assert [made.cache(key)[1][0] for key in (0, 1)] == [0, 1]
