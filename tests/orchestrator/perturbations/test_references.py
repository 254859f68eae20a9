"""Looks are kept by seed and scene, those asked for last."""

from robogauntlet.orchestrator.perturbations.base import ReferenceImages


class Drawing:
    """Counts how often it is asked to draw."""

    times = 0

    def __call__(self):
        self.times += 1
        return {"third_person": self.times}


def test_a_look_is_drawn_once_for_a_seed_and_a_scene():
    references, draw = ReferenceImages(), Drawing()
    looks = [references.get(*key, draw)["third_person"] for key in ((1, "clean"), (1, "clean"), (2, "clean"), (1, "x"))]
    assert looks == [1, 1, 2, 3]


def test_the_looks_asked_for_last_are_kept():
    references, draw = ReferenceImages(size=2), Drawing()
    for seed in (1, 2, 1, 3):
        references.get(seed, "clean", draw)
    assert [references.get(seed, "clean", draw)["third_person"] for seed in (1, 3, 2)] == [1, 3, 4]
