"""The checks of an adapter: a module for each family, a function that yields violations for each check."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from robogauntlet.orchestrator.kit.adapter import (
    actions,
    axes,
    cameras,
    culling,
    motion,
    observations,
    resources,
    scene,
    scene_control,
    seeds,
    types,
)
from robogauntlet.orchestrator.kit.adapter.check import Check

FAMILIES = (types, motion, seeds, observations, actions, cameras, scene_control, scene, culling, axes, resources)
CHECKS: Mapping[str, Check] = MappingProxyType({check.name: check for family in FAMILIES for check in family.CHECKS})
"""Every check by name, in the order in which they run: the foundations of the others first."""
