"""Scripted oracles for the gymnasium environments that come with a mapping file."""

from __future__ import annotations

from collections.abc import Callable

from robogauntlet.policies.oracles.motion import Script
from robogauntlet.policies.oracles.pybullet import PickAndPlace, Reach


class FetchPickAndPlace(PickAndPlace):
    """Same as for panda-gym's smaller cube."""

    HELD_WIDTH = 0.054


SCRIPTS: dict[str, Callable[[], Script]] = {
    "gymnasium/FetchReach-v4": Reach,
    "gymnasium/FetchPickAndPlace-v4": FetchPickAndPlace,
    "gymnasium/PandaReach-v3": Reach,
}
