"""The cache of reference images."""

from robogauntlet.orchestrator.perturbations.base import ReferenceImages


class Renderer:
    """Counts its calls."""

    times = 0

    def __call__(self):
        self.times += 1
        return {"third_person": self.times}


def test_images_are_rendered_once_per_seed_and_scene():
    references, render = ReferenceImages(), Renderer()
    images = [
        references.get(*key, render)["third_person"] for key in ((1, "clean"), (1, "clean"), (2, "clean"), (1, "x"))
    ]
    assert images == [1, 1, 2, 3]


def test_the_most_recently_used_images_are_kept():
    references, render = ReferenceImages(size=2), Renderer()
    for seed in (1, 2, 1, 3):
        references.get(seed, "clean", render)
    assert [references.get(seed, "clean", render)["third_person"] for seed in (1, 3, 2)] == [1, 3, 4]
