"""Metadata of a merged checkpoint. Light: a run can be planned without torch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Annotated, Any, ClassVar, Self

from pydantic import Field, StrictInt
from pydantic.dataclasses import dataclass

from robogauntlet.policies.mergevla.checkpoints.metadata import (
    CheckpointError,
    StoredMetadata,
    check_action_steps,
    locate,
)
from robogauntlet.policies.mergevla.merging.recipe import Recipe
from robogauntlet.policies.mergevla.network.config import Architecture
from robogauntlet.policies.mergevla.network.normalisation import TaskStatistics
from robogauntlet.policies.stored import STRICT
from robogauntlet.suites.episode import content_hash

KIND = "merged"
"""The kind of a merged checkpoint in its metadata."""


@dataclass(frozen=True, config=STRICT)
class MergedMetadata(StoredMetadata):
    """Everything about a merged checkpoint except its tensors."""

    kind: ClassVar = KIND
    left_out_if_empty: ClassVar = ("tasks_of_several",)

    architecture: Architecture
    statistics: TaskStatistics
    """Normalisation statistics of each expert, in the experts' order."""
    recipe: Recipe
    instructions: Mapping[str, str]
    """Task to its instruction."""
    expert_digests: Mapping[str, str]
    """Expert to the digest of the checkpoint that was merged."""
    base: str
    """Checkpoint of the base: a folder relative to this one, or a hub id."""
    base_hash: str
    """`tensor_hash` of the base."""
    tasks_of_several: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Expert of several tasks to these; an expert of one task has its name."""
    action_steps: Mapping[str, StrictInt] = field(default_factory=dict)
    """Expert to its `CheckpointMetadata.action_steps`; those that execute whole chunks are left out."""
    rescalers: Mapping[str, Annotated[float, Field(strict=True, allow_inf_nan=False)]] = field(default_factory=dict)
    """Expert to EMR's rescaler; empty without EMR's masks."""
    routers: tuple[str, ...] = ()
    """Routers that were fitted, whose tensors are stored."""
    report: Mapping[str, Any] = field(default_factory=dict)
    """`merging.diagnostics.MergeReport` of the merge."""
    tensor_hash: str = ""
    """`hash_tensors` of the weights' file; filled in when the checkpoint is saved."""

    def __post_init__(self) -> None:
        if odd := sorted(set(self.tasks_of_several) - set(self.experts)):
            raise CheckpointError(f"expected tasks of the merged experts, got some of {odd[0]}")
        tasks = [task for tasks in self.tasks.values() for task in tasks]
        if twice := sorted(task for task in set(tasks) if tasks.count(task) > 1):
            raise CheckpointError(f"expected one expert per task, {twice[0]} has several")
        for names, what, values in (
            (tasks, "instruction of each task", self.instructions),
            (self.experts, "digest of each merged expert", self.expert_digests),
        ):
            if odd := sorted(set(values) ^ set(names)):
                raise CheckpointError(f"expected statistics and an {what}, {odd[0]} has one of them only")
        for steps in self.action_steps.values():
            check_action_steps(steps, self.architecture)

    @property
    def experts(self) -> tuple[str, ...]:
        """Names of the merged experts, see `CheckpointMetadata.expert`."""
        return self.statistics.tasks

    @property
    def tasks(self) -> dict[str, tuple[str, ...]]:
        """Expert to its tasks (`simulator/task`)."""
        return {expert: self.tasks_of_several.get(expert, (expert,)) for expert in self.experts}

    @property
    def digest(self) -> str:
        """Hash of everything that decides how the model routes and acts."""
        decisive = {
            "kind": KIND,
            "architecture": self.architecture.as_json(),
            "statistics": self.statistics.as_json(),
            "recipe": self.recipe.as_json(),
            "instructions": dict(self.instructions),
            "rescalers": dict(self.rescalers),
            "tensors": self.tensor_hash,
            "base": self.base_hash,
        }
        for name in ("action_steps", "tasks_of_several"):
            if given := getattr(self, name):
                decisive[name] = dict(given)
        return content_hash(decisive)

    def as_json(self) -> dict[str, Any]:
        """Return the metadata as plain JSON; `from_json` is the inverse."""
        return {**super().as_json(), "experts": list(self.experts)}

    @classmethod
    def from_json(cls, plain: Mapping[str, Any]) -> Self:
        """Read what `as_json` wrote, its statistics in the experts' order. Raises PolicyError if it is malformed."""
        if plain.get("kind") == KIND:
            fields = dict(plain)
            experts, statistics = fields.pop("experts", None), fields.get("statistics")
            if not isinstance(experts, list) or not isinstance(statistics, Mapping) or set(experts) != set(statistics):
                raise CheckpointError(
                    "expected normalisation statistics of each merged expert in the metadata, got others"
                )
            plain = {**fields, "statistics": {expert: statistics[expert] for expert in experts}}
        return super().from_json(plain)


def merged_digest_of(reference: str) -> str:
    """Return the hash of a merged checkpoint's content. Raises PolicyError if the checkpoint cannot be used."""
    return MergedMetadata.verified(locate(reference)).digest
