"""What MergeVLA's policies need and produce, from the metadata of checkpoints. Light: no torch."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

from robogauntlet.policies.contract import PolicyInput, PolicyMismatch, PolicySpec
from robogauntlet_mergevla.checkpoints.metadata import CheckpointMetadata
from robogauntlet_mergevla.network.config import Architecture

ORACLE_ROUTER = "oracle"
"""The router that is given the true task."""
UNFITTED_ROUTERS = (ORACLE_ROUTER, "delta-energy", "instruction-match", "paper-coded", "paper-written", "random")
"""Routers that any checkpoint has: the keys of `routing.catalog.UNFITTED`."""


def policy_spec(architecture: Architecture, action_dims: Collection[int]) -> PolicySpec:
    """Return the spec of a policy of this architecture that was trained in tasks with actions of these sizes."""
    return PolicySpec(
        PolicyInput.OBSERVATION,
        chunk_length=architecture.chunk_length,
        action_dim=None if len(action_dims) > 1 else max(action_dims),
        cameras=architecture.cameras,
        image_size=architecture.image_size,
    )


def experts_spec(experts: Mapping[str, CheckpointMetadata]) -> PolicySpec:
    """Return the spec of a policy that has an expert for each of these tasks.

    Raises PolicyMismatch if they differ in chunk length, cameras or image size.
    """
    action_dims = {number for one in experts.values() for number in one.statistics.action_dims}
    specs = {task: policy_spec(one.architecture, action_dims) for task, one in experts.items()}
    first, spec = next(iter(specs.items()))
    for task, other in specs.items():
        if other != spec:
            raise PolicyMismatch(
                f"expected experts with one chunk length, cameras and image size, got others for {first} and {task}"
            )
    return replace(spec, tasks=frozenset(experts), variants=True)


def merged_spec(
    architecture: Architecture, action_dims: Collection[int], tasks: Collection[str], router: str
) -> PolicySpec:
    """Return the spec of a merged policy, which acts in its experts' tasks only if it is given the true task."""
    spec = policy_spec(architecture, action_dims)
    return replace(spec, tasks=frozenset(tasks), variants=True) if router == ORACLE_ROUTER else spec
