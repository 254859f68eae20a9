"""Saving and loading merged models as folders, laid out as those of one network are."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from torch import Tensor

from policies.mergevla.card import WEIGHTS, CheckpointError, base_folder, locate
from policies.mergevla.checkpoint import check_architecture, check_finite, load_tensors, name_of_base, write_folder
from policies.mergevla.lora import Factors
from policies.mergevla.merged_card import MergedCard, verified_merged_card
from policies.mergevla.merged_model import Parts
from policies.mergevla.merging.errors import ExpertsDiffer
from policies.mergevla.merging.masks import Mask, MaskMismatch, check_mask, pack_mask, unpack_mask
from policies.mergevla.merging.merged import MergedTau
from policies.mergevla.merging.recipe import BackboneRule, MaskRule
from policies.mergevla.merging.signs import check_row_scales
from policies.mergevla.merging.taus import Weights, difference
from policies.mergevla.merging_experts import Merging
from policies.mergevla.tensor_files import read_tensors

TAU, TRUNK, MASK, SCALE, RESIDUAL, HEAD, ADAPTER, SUBSPACE, ROUTER = SECTIONS = (
    "tau",
    "trunk",
    "mask",
    "scale",
    "residual",
    "head",
    "adapter",
    "subspace",
    "router",
)
"""First words of the tensors' names. What belongs to an expert follows its number; experts are named in the card."""


@dataclass(frozen=True, eq=False)
class MergedCheckpoint:
    """A merged model and what is known about it."""

    parts: Parts
    card: MergedCard
    fitted: Weights
    """What routers were fitted to, by `<router>/...`, as `routing.catalog.fit_routers` gives it."""


def save_merged(folder: Path, merging: Merging, fitted: Weights | None = None) -> MergedCard:
    """Write a merged checkpoint; the base stays where it is.

    Args:
        folder: Where to, made if need be.
        merging: What came of the merge.
        fitted: What routers were fitted to, see `MergedCheckpoint`.

    Returns:
        The card as written.

    Raises:
        CheckpointError: NaN or infinite weights.
        OSError: A full disk, or the like.
    """
    parts = merging.parts
    tensors = _tensors(parts) | _under(ROUTER, fitted or {})
    check_finite(tensors, folder)
    _, base_card = load_tensors(merging.base)
    folder.mkdir(parents=True, exist_ok=True)
    card = MergedCard(
        architecture=parts.architecture,
        statistics=parts.statistics,
        recipe=parts.recipe,
        instructions=parts.instructions,
        expert_digests=parts.expert_digests,
        action_steps=parts.action_steps,
        base=name_of_base(folder, merging.base),
        base_hash=base_card.tensor_hash,
        rescalers=parts.merged.rescalers,
        routers=tuple(sorted({name.partition("/")[0] for name in fitted or {}})),
        report=json.loads(merging.report.to_json()),
    )
    return write_folder(folder, {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}, card)


def load_merged(reference: str | Path) -> MergedCheckpoint:
    """Read a merged checkpoint, verified.

    Raises:
        PolicyError: No merged checkpoint, truncated, not of the card's hash, with NaN weights, with a mask for another
            model, or on a base of another architecture.
    """
    folder = locate(str(reference))
    card = verified_merged_card(folder)
    base, base_card = load_tensors(base_folder(folder, card.base))
    check_architecture(folder, card.architecture, base_card.architecture)
    tensors = read_tensors(folder / WEIGHTS)
    check_finite(tensors, folder)
    sections = {name.partition("/")[0] for name in tensors}
    if odd := sorted(sections - set(SECTIONS)):
        raise CheckpointError(f"'{folder}': expected the tensors of a merged model, got {odd[0]}")
    try:
        parts = _parts(card, tensors, base)
    except (ExpertsDiffer, MaskMismatch, CheckpointError) as error:
        raise type(error)(f"'{folder}': {error}") from None
    return MergedCheckpoint(parts, card, _section(tensors, ROUTER))


def _tensors(parts: Parts) -> dict[str, Tensor]:
    tensors = _merged_tensors(parts.merged) | _under(TRUNK, parts.trunk)
    for number, expert in enumerate(parts.statistics.tasks):
        tensors |= _under(f"{HEAD}/{number}", parts.heads[expert])
        for weight, factors in parts.adapters.get(expert, {}).items():
            scaled = {"a": factors.a.float(), "b": factors.b.float() * factors.scale}
            tensors |= _under(f"{ADAPTER}/{number}/{weight}", scaled)
        adapter, task = parts.subspaces[expert]
        tensors |= {f"{SUBSPACE}/{number}/v_adapter": adapter, f"{SUBSPACE}/{number}/v_task": task}
    return tensors


def _merged_tensors(merged: MergedTau) -> dict[str, Tensor]:
    halved = {name: delta.bfloat16() for name, delta in merged.tau.items()} if merged.rule is MaskRule.SIGNS else None
    tensors = _under(TAU, halved or merged.tau)
    for number, expert in enumerate(merged.experts):
        if merged.masks:
            tensors |= _under(f"{MASK}/{number}", pack_mask(merged.masks[expert]))
        tensors |= _under(f"{SCALE}/{number}", merged.row_scales.get(expert, {}))
    return tensors | (_under(RESIDUAL, _merged_tensors(merged.residual)) if merged.residual else {})


def _merged(card: MergedCard, tensors: Weights, rounds: int) -> MergedTau:
    numbered = {expert: str(number) for number, expert in enumerate(card.experts)}
    recipe, tau = card.recipe, {name: delta.float() for name, delta in _section(tensors, TAU).items()}
    rule = recipe.masks if tau else MaskRule.NONE
    signs = rule is MaskRule.SIGNS
    if rule is MaskRule.EMR:
        _check_rescalers(card)
    per_expert = recipe.lambda_ if isinstance(recipe.lambda_, Mapping) else dict.fromkeys(card.experts, recipe.lambda_)
    return MergedTau(
        experts=card.experts,
        operator=recipe.operator,
        alpha=recipe.alpha,
        rule=rule,
        tau=tau,
        masks={expert: _mask(tensors, n, tau) for expert, n in numbered.items()} if rule is not MaskRule.NONE else {},
        lambdas=per_expert if rule is MaskRule.TASK else {},
        rescalers=card.rescalers,
        row_scales={expert: _row_scales(tensors, n, tau) for expert, n in numbered.items()} if signs else {},
        options=recipe.options,
        residual=_merged(card, _section(tensors, RESIDUAL), rounds - 1) if signs and rounds > 1 else None,
    )


def _check_rescalers(card: MergedCard) -> None:
    numbers = (value for value in card.rescalers.values() if isinstance(value, int | float) and math.isfinite(value))
    if set(card.rescalers) != set(card.experts) or len(list(numbers)) != len(card.experts):
        raise CheckpointError(f"expected a rescaler of each merged expert, got {dict(card.rescalers)}")


def _parts(card: MergedCard, tensors: Weights, base: Weights) -> Parts:
    numbered = {expert: str(number) for number, expert in enumerate(card.experts)}
    recipe = card.recipe
    merged = _merged(card, tensors, recipe.rounds)
    if merged.residual and (problem := difference(merged.tau, merged.residual.tau)):
        raise ExpertsDiffer(f"the second round is for another model: {problem}")
    selects = recipe.backbone is BackboneRule.SELECT
    return Parts(
        architecture=card.architecture,
        statistics=card.statistics,
        instructions=card.instructions,
        recipe=recipe,
        base=base,
        merged=merged,
        trunk=_section(tensors, TRUNK),
        adapters={expert: _adapters(tensors, n, base) for expert, n in numbered.items()} if selects else {},
        heads={expert: _section(tensors, f"{HEAD}/{n}") for expert, n in numbered.items()},
        subspaces={expert: _subspaces(tensors, n) for expert, n in numbered.items()},
        expert_digests=card.expert_digests,
        action_steps=card.action_steps,
    )


def _mask(tensors: Weights, number: str, tau: Weights) -> Mask:
    mask = unpack_mask(_section(tensors, f"{MASK}/{number}"))
    check_mask(mask, tau)
    return mask


def _row_scales(tensors: Weights, number: str, tau: Weights) -> dict[str, Tensor]:
    scales = _section(tensors, f"{SCALE}/{number}")
    check_row_scales(scales, tau)
    return scales


def _adapters(tensors: Weights, number: str, base: Weights) -> dict[str, Factors]:
    section = _section(tensors, f"{ADAPTER}/{number}")
    found = {}
    for weight in sorted({name.rpartition("/")[0] for name in section}):
        if weight not in base or not {f"{weight}/a", f"{weight}/b"} <= section.keys():
            raise ExpertsDiffer(f"expected both factors of a weight of the base, got {weight}")
        a, b, shape = section[f"{weight}/a"], section[f"{weight}/b"], base[weight].shape
        if a.shape[0] != b.shape[1] or a[0].numel() * b.shape[0] != shape.numel():
            raise ExpertsDiffer(
                f"expected factors of shape {tuple(shape)} for {weight}, got {(*b.shape,)}, {(*a.shape,)}"
            )
        found[weight] = Factors(a, b, 1.0, shape)
    return found


def _subspaces(tensors: Weights, number: str) -> tuple[Tensor, Tensor]:
    section = _section(tensors, f"{SUBSPACE}/{number}")
    if section.keys() != {"v_adapter", "v_task"}:
        raise CheckpointError(f"expected the value projections of expert {number}, got {', '.join(section) or 'none'}")
    return section["v_adapter"], section["v_task"]


def _under(prefix: str, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {f"{prefix}/{name}": tensor for name, tensor in tensors.items()}


def _section(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {
        name.removeprefix(f"{prefix}/"): tensor for name, tensor in tensors.items() if name.startswith(f"{prefix}/")
    }
