"""What a merged checkpoint says about itself. Light, as `card` is: a run can be planned without torch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from policies.contract import PolicyError
from policies.mergevla.card import (
    FORMAT,
    WEIGHTS,
    CheckpointError,
    base_folder,
    card_json,
    check_action_steps,
    check_format,
    check_hash,
    check_text,
    hash_tensors,
    locate,
    verified_card,
)
from policies.mergevla.config import Architecture
from policies.mergevla.merging.recipe import Recipe
from policies.mergevla.normalisation import TaskStatistics
from suites.vocabulary import content_hash

KIND = "merged"
"""What a merged checkpoint's card has as its kind; that of one network has none."""


@dataclass(frozen=True)
class MergedCard:
    """Everything about a merged checkpoint but its tensors."""

    architecture: Architecture
    statistics: TaskStatistics
    """Of each expert's task, in the experts' order."""
    recipe: Recipe
    instructions: Mapping[str, str]
    """Expert to the instruction of its task."""
    expert_digests: Mapping[str, str]
    """Expert to the digest of the checkpoint that was merged."""
    base: str
    """Checkpoint of the base: a folder relative to this one, or a hub id."""
    base_hash: str
    """That checkpoint's `tensor_hash`."""
    action_steps: Mapping[str, int] = field(default_factory=dict)
    """Expert to its `Card.action_steps`; those that execute whole chunks are left out."""
    rescalers: Mapping[str, float] = field(default_factory=dict)
    """Expert to EMR's rescaler; empty without EMR's masks."""
    routers: tuple[str, ...] = ()
    """Routers that were fitted, whose tensors are stored."""
    report: Mapping[str, Any] = field(default_factory=dict)
    """`merging.diagnostics.MergeReport` of the merge."""
    tensor_hash: str = ""
    """`hash_tensors` of the weights' file; filled in when the checkpoint is saved."""

    def __post_init__(self) -> None:
        for name, found in (("instruction", self.instructions), ("digest", self.expert_digests)):
            if odd := sorted(set(found) ^ set(self.experts)):
                raise CheckpointError(
                    f"expected statistics and an {name} of each merged expert, {odd[0]} has one of them only"
                )

    @property
    def experts(self) -> tuple[str, ...]:
        """The tasks whose experts were merged (`simulator/task`)."""
        return self.statistics.tasks

    @property
    def digest(self) -> str:
        """Hash of all that decides how the model routes and acts."""
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
        return content_hash(decisive | ({"action_steps": dict(self.action_steps)} if self.action_steps else {}))

    def sealed(self, tensor_hash: str) -> MergedCard:
        """The card for these tensors."""
        return replace(self, tensor_hash=tensor_hash)

    def as_json(self) -> dict[str, Any]:
        """As plain JSON; `MergedCard.from_json` is the inverse."""
        return {
            "format": FORMAT,
            "kind": KIND,
            **asdict(self),
            "architecture": self.architecture.as_json(),
            "statistics": self.statistics.as_json(),
            "recipe": self.recipe.as_json(),
            "experts": list(self.experts),
        }

    @classmethod
    def from_json(cls, plain: Mapping[str, Any]) -> MergedCard:
        """The card that `as_json` wrote.

        Raises:
            PolicyError: It is something else, or its statistics are missing.
        """
        parts = dict(plain)
        if (kind := parts.pop("kind", None)) != KIND:
            raise CheckpointError(f"expected a {KIND} checkpoint, got {kind or 'one network'}")
        check_format(parts.pop("format", None))
        experts, statistics = parts.pop("experts", None), parts.get("statistics")
        if not isinstance(experts, list) or not isinstance(statistics, Mapping) or set(experts) != set(statistics):
            raise CheckpointError("expected normalisation statistics of each merged expert in the card, got others")
        parts["statistics"] = TaskStatistics.from_json({expert: statistics[expert] for expert in experts})
        parts["architecture"] = Architecture.from_json(parts.get("architecture") or {})
        check_text(parts, "base", "base_hash", "tensor_hash")
        for name in ("action_steps", "rescalers", "instructions", "expert_digests"):
            if not isinstance(parts.get(name, {}), Mapping):
                raise CheckpointError(f"expected {name} by expert, got {parts[name]!r}")
        for steps in parts.get("action_steps", {}).values():
            check_action_steps(steps, parts["architecture"])
        try:
            parts["recipe"] = Recipe.from_json(parts["recipe"])
            parts["routers"] = tuple(parts["routers"])
            return cls(**parts)
        except (KeyError, TypeError) as error:
            raise CheckpointError(f"expected a card, got one that does not read: {error}") from None


def verified_merged_card(folder: Path) -> MergedCard:
    """The card, once the tensors beside it and the base's are found to be the ones it speaks of.

    Raises:
        PolicyError: They are not.
    """
    try:
        card = MergedCard.from_json(card_json(folder))
    except PolicyError as error:
        raise type(error)(f"'{folder}': {error}") from None
    check_hash(folder / WEIGHTS, card.tensor_hash, hash_tensors(folder / WEIGHTS))
    base = base_folder(folder, card.base)
    check_hash(base / WEIGHTS, card.base_hash, verified_card(base).tensor_hash)
    return card


def merged_digest_of(reference: str) -> str:
    """Hash of a merged checkpoint's content, verified.

    Raises:
        PolicyError: It cannot be used.
    """
    return verified_merged_card(locate(reference)).digest
