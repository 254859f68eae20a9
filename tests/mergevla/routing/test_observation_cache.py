"""First observations in a file."""

import numpy as np
import pytest

from robogauntlet.adapters.contract import Observation
from robogauntlet.suites.episode import View
from robogauntlet_mergevla.routing.contract import RoutingError
from robogauntlet_mergevla.routing.observation_cache import (
    ObservationCache,
    file_of,
    load_observations,
    save_observations,
)
from tests.errors import one_line_error

VIEW = View(image_size=16)


def cache(seeds=range(3), task="null/Reach"):
    generator = np.random.default_rng(0)

    def observation(seed):
        images = {camera: generator.integers(0, 256, (16, 16, 3), np.uint8) for camera in VIEW.cameras}
        return Observation(images, generator.normal(size=8), f"reach é {seed}")

    return ObservationCache.of(task, VIEW, seeds, [observation(seed) for seed in seeds])


def test_stored_observations_are_read_back(tmp_path):
    stored = cache()
    path = file_of(tmp_path, stored.task)
    save_observations(stored, path)
    assert [file.name for file in tmp_path.iterdir()] == ["null__Reach.npz"]
    kept = load_observations(path)
    assert (kept.task, kept.view, kept.seeds, kept.instructions) == (stored.task, VIEW, (0, 1, 2), stored.instructions)
    assert np.array_equal(kept.images, stored.images)
    assert np.array_equal(kept.proprioception, stored.proprioception)


def test_first_observations_are_in_the_order_of_the_seeds():
    stored = cache()
    first, second = stored.observations([2, 0])
    assert [first.instruction, second.instruction] == ["reach é 2", "reach é 0"]
    assert first.task == "null/Reach"
    assert np.array_equal(first.images[1].permute(1, 2, 0).numpy() * 255, stored.images[2, 1])
    assert first.episode_id == cache([2]).observations([2])[0].episode_id
    assert first.episode_id != cache([2], "null/Slow").observations([2])[0].episode_id


def test_other_seeds_or_another_view_are_not_covered():
    stored = cache()
    assert stored.covers(VIEW, [1, 2])
    assert not stored.covers(VIEW, [2, 3])
    assert not stored.covers(View(image_size=32), [1])


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"no archive", b"\x80\x04K\x01."])
def test_a_file_of_another_format_is_refused_in_one_line(content, tmp_path):
    path = tmp_path / "x.npz"
    path.write_bytes(content)
    with one_line_error(RoutingError, r"x\.npz: expected first observations of a task, got .+"):
        load_observations(path)


def test_an_archive_of_other_arrays_is_refused(tmp_path):
    np.savez(tmp_path / "x.npz", images=np.zeros(3))
    with pytest.raises(RoutingError, match="expected first observations of a task"):
        load_observations(tmp_path / "x.npz")
    np.savez(tmp_path / "p.npz", cameras=np.array([{}]))
    with pytest.raises(RoutingError, match="allow_pickle=False"):
        load_observations(tmp_path / "p.npz")


def test_shapes_that_do_not_fit_are_refused():
    stored = cache()
    with pytest.raises(RoutingError, match=r"null/Reach: expected images of shape \(3, 2, 16, 16, 3\) of uint8, got"):
        ObservationCache("null/Reach", VIEW, (0, 1, 2), stored.images[:2], stored.proprioception, stored.instructions)
    with pytest.raises(RoutingError, match=r"an instruction of 3 episodes, got \(3, 8\) and 1 instructions"):
        ObservationCache("null/Reach", VIEW, (0, 1, 2), stored.images, stored.proprioception, ("reach",))
