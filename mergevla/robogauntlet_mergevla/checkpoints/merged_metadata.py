"""Metadata of a merged checkpoint. Light: a run can be planned without torch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

from pydantic import Field, StrictInt
from pydantic.dataclasses import dataclass

from robogauntlet.policies.stored import STRICT
from robogauntlet.suites.episode import content_hash
from robogauntlet_mergevla.checkpoints.metadata import (
    CheckpointError,
    CheckpointMetadata,
    StoredMetadata,
    base_folder,
    check_action_steps,
    check_statistics,
    locate,
)
from robogauntlet_mergevla.merging.recipe import Recipe
from robogauntlet_mergevla.network.config import Architecture
from robogauntlet_mergevla.network.normalisation import TaskStatistics

KIND = "merged"
"""The kind of a merged checkpoint in its metadata."""


@dataclass(frozen=True, config=STRICT)
class MergedMetadata(StoredMetadata):
    """Everything about a merged checkpoint except its tensors."""

    kind: ClassVar = KIND
    left_out_if_empty: ClassVar = ("tasks_of_several", "checkpoints", "merged_hash")

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
    checkpoints: Mapping[str, str] = field(default_factory=dict)
    """Expert to its checkpoint, a folder relative to this one or a hub id, of which the model is merged when it is
    loaded; empty if the merged weights are stored."""
    merged_hash: str = ""
    """`hash_tensors` of the file with the merged weights, if these are not stored."""
    tensor_hash: str = ""
    """`hash_tensors` of the weights' file; filled in when the checkpoint is saved."""

    def __post_init__(self) -> None:
        if bool(self.checkpoints) != bool(self.merged_hash):
            raise CheckpointError("expected checkpoints and merged_hash together in the metadata, got one of them")
        if odd := sorted(set(self.tasks_of_several) - set(self.experts)):
            raise CheckpointError(f"expected tasks of the merged experts, got some of {odd[0]}")
        tasks = [task for tasks in self.tasks.values() for task in tasks]
        if twice := sorted(task for task in set(tasks) if tasks.count(task) > 1):
            raise CheckpointError(f"expected one expert per task, {twice[0]} has several")
        for names, what, values in (
            (tasks, "instruction of each task", self.instructions),
            (self.experts, "digest of each merged expert", self.expert_digests),
            (self.experts, "checkpoint of each merged expert", self.checkpoints or self.experts),
        ):
            if odd := sorted(set(values) ^ set(names)):
                raise CheckpointError(f"expected statistics and the {what}, {odd[0]} has one of them only")
        for steps in self.action_steps.values():
            check_action_steps(steps, self.architecture)
        check_statistics(self.statistics, self.architecture)

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
            "tensors": self.merged_hash or self.tensor_hash,
            "base": self.base_hash,
        }
        for name in ("action_steps", "tasks_of_several"):
            if given := getattr(self, name):
                decisive[name] = dict(given)
        return content_hash(decisive)

    @classmethod
    def verified(cls, folder: Path) -> Self:
        """Check as any checkpoint is checked, and that the experts to be merged are those of the metadata."""
        metadata = super().verified(folder)
        for expert, digest in metadata.expert_digests.items() if metadata.checkpoints else ():
            found = CheckpointMetadata.verified(metadata.expert_folder(folder, expert)).digest
            if found != digest:
                raise CheckpointError(f"'{folder}': expected expert {expert} of digest {digest}, got {found}")
        return metadata

    def expert_folder(self, folder: Path, expert: str) -> Path:
        """Return the folder of one of `checkpoints`; `folder` is this checkpoint's. Raises CheckpointError."""
        return base_folder(folder, self.checkpoints[expert], f"expert {expert}")

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
