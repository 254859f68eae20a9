"""How many workers fit a Ray."""

import pytest

from robogauntlet.orchestrator.ray_runtime.session import WORKER_BYTES, room_for_workers


@pytest.mark.parametrize(
    ("resources", "workers"),
    [
        ({"CPU": 8.0, "memory": 100.0 * WORKER_BYTES}, 8),
        ({"CPU": 8.0, "memory": 3.9 * WORKER_BYTES}, 3),
        ({"CPU": 8.0}, 8),
        ({"CPU": 0.5, "memory": 0.5 * WORKER_BYTES}, 1),
    ],
)
def test_workers_fit_cores_and_memory_and_are_at_least_one(resources, workers, monkeypatch):
    monkeypatch.setattr("ray.cluster_resources", lambda: resources)
    assert room_for_workers() == workers
