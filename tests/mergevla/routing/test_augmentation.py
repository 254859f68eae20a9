"""Augmented first observations."""

from dataclasses import replace

import torch
from hypothesis import given, strategies as st

from robogauntlet_mergevla.routing.augmentation import augmented
from tests.mergevla.routing.synthetic import observation

WORDS = "push the green cube onto the red goal"


@given(st.integers(0, 2**62))
def test_variants_leave_out_words_and_keep_images_in_range(seed):
    own, fewer, seen, both = augmented([replace(observation(seed), instruction=WORDS)], sees_instruction=True)
    assert (own.images is fewer.images, own.instruction) == (True, WORDS)
    assert (seen.images is both.images, seen.instruction) == (True, WORDS)
    for one in (fewer, both):
        left = iter(WORDS.split())
        assert all(word in left for word in one.instruction.split())
    assert seen.images.shape == own.images.shape
    assert 0.0 <= seen.images.min() <= seen.images.max() <= 1.0
    assert not torch.equal(seen.images, own.images)


def test_the_variants_of_a_first_observation_do_not_depend_on_its_batch():
    alone = augmented([observation(5)], sees_instruction=True)
    in_batch = augmented([observation(4), observation(5)], sees_instruction=True)
    assert [one.instruction for one in alone] == [one.instruction for one in in_batch[4:]]
    assert torch.equal(alone[2].images, in_batch[6].images)


def test_a_hidden_instruction_is_not_varied():
    own, seen = augmented([observation(5)], sees_instruction=False)
    assert seen.instruction == own.instruction
    assert torch.equal(seen.images, augmented([own], sees_instruction=True)[2].images)


def test_a_uniform_image_stays_uniform_under_the_same_light():
    grey = replace(observation(5), images=torch.full((2, 3, 16, 16), 0.4))
    seen = augmented([grey], sees_instruction=False)[1].images
    assert torch.allclose(seen, seen[:1, :, :1, :1].expand_as(seen), atol=1e-6)
    assert seen.min() > 0.4 * 0.37 / 1.35


def test_frames_are_moved_and_sized_within_bounds():
    """A bright line at the middle of the image stays within a shift of .075 of the side."""
    line = torch.zeros(2, 3, 40, 40)
    line[..., 19:21] = 0.5
    places = []
    for seed in range(60):
        seen = augmented([replace(observation(seed), images=line)], sees_instruction=False)[1].images
        weight = seen[:, 0].sum(dim=1)
        places += ((weight * torch.arange(40)).sum(dim=1) / weight.sum(dim=1)).tolist()
    away = torch.tensor(places) - 19.5
    assert away.abs().max() < 40 * 0.075 * 1.3 + 0.5
    assert away.abs().max() > 40 * 0.05
    assert away.mean().abs() < 1.0
