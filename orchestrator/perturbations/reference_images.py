"""ImagePairs that perturbed episodes are measured against, kept for as long as a simulation is open."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping

from robogauntlet.adapters.contract import Image

Images = Mapping[str, Image]
"""Camera to what it sees, each of shape (h, w, 3)."""
MOST = 512
"""ImagePairs that are kept: 28 MB at two cameras of 96 px."""


class ReferenceImages:
    """What a task looks like at the start of a seed, in its own scene or in one made for measuring.

    Many conditions and policies are measured against the same look. Equal seeds are drawn equal to the bit, so one that
    was kept is what would be drawn again: keeping it changes no result, and saves a frame of each episode.
    """

    def __init__(self, most: int = MOST) -> None:
        """Args: most: looks to keep; those asked for last stay."""
        self._most = most
        self._kept: OrderedDict[tuple[int, str], Images] = OrderedDict()

    def get(self, seed: int, scene: str, draw: Callable[[], Images]) -> Images:
        """The look of a seed's scene, drawn if it is not there."""
        key = (seed, scene)
        if key not in self._kept:
            self._kept[key] = draw()
        self._kept.move_to_end(key)
        while len(self._kept) > self._most:
            self._kept.popitem(last=False)
        return self._kept[key]
