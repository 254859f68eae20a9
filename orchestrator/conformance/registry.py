"""All checks, in the order in which they are played: what others rely on comes first."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from orchestrator.conformance import (
    actions,
    adjusting,
    axes,
    cameras,
    declaring,
    looks,
    resources,
    scenery,
    seeds,
    success,
    types,
)
from orchestrator.conformance.findings import Check

FAMILIES = (declaring, types, seeds, looks, actions, success, cameras, adjusting, scenery, axes, resources)
CHECKS: Mapping[str, Check] = MappingProxyType({check.name: check for family in FAMILIES for check in family.CHECKS})
"""Every check by name."""
