"""Saving and loading merged models, in folders of the same layout as those of one network."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

from torch import Tensor

from robogauntlet_mergevla.checkpoints.expert_checkpoint import (
    check_architecture,
    check_finite,
    load_tensors,
    name_of_base,
    read_tensors,
    write_folder,
)
from robogauntlet_mergevla.checkpoints.expert_copies import Copy, restored, unpacked_copy
from robogauntlet_mergevla.checkpoints.merge_experts import Merging, merge_parts, read_experts
from robogauntlet_mergevla.checkpoints.merged_metadata import MergedMetadata
from robogauntlet_mergevla.checkpoints.merged_model import MergedWeights
from robogauntlet_mergevla.checkpoints.metadata import (
    WEIGHTS,
    CheckpointError,
    base_folder,
    locate,
)
from robogauntlet_mergevla.merging.errors import ExpertsDiffer
from robogauntlet_mergevla.merging.masks import Mask, MaskMismatch, check_mask, pack_mask, unpack_mask
from robogauntlet_mergevla.merging.merge import MergedTaskVectors
from robogauntlet_mergevla.merging.quantisation import pack
from robogauntlet_mergevla.merging.recipe import BackboneRule, MaskRule, Recipe
from robogauntlet_mergevla.merging.signs import check_row_scales
from robogauntlet_mergevla.merging.task_vectors import Weights, difference
from robogauntlet_mergevla.network.lora import Factors

TAU, TRUNK, MASK, SCALE, RESIDUAL, HEAD, ADAPTER, COPY, SUBSPACE, ROUTER = SECTIONS = (
    "tau",
    "trunk",
    "mask",
    "scale",
    "residual",
    "head",
    "adapter",
    "copy",
    "subspace",
    "router",
)
"""First parts of the tensors' names. An expert's tensors have its number next; the metadata names the experts."""
Subspaces = tuple[Tensor, Tensor]
"""Of an expert, see `MergedWeights.subspaces`."""
BESIDE_WEIGHTS = (SUBSPACE, ROUTER)
"""Those that are stored even without the merged weights."""


@dataclass(frozen=True, eq=False)
class MergedCheckpoint:
    """A merged model and its metadata."""

    metadata: MergedMetadata
    fitted: Weights
    """Tensors of the fitted routers, by `<router>/...`: the result of `routing.catalog.fit_routers`."""
    make_parts: Callable[[], MergedWeights]
    """Returns the merged model; takes seconds if its weights are not stored."""

    @cached_property
    def parts(self) -> MergedWeights:
        """The merged model. Raises PolicyError if it has to be merged and the experts do not fit."""
        return self.make_parts()


def save_merged(
    folder: Path, merging: Merging, fitted: Weights | None = None, *, weights: bool = True
) -> MergedMetadata:
    """Write a merged checkpoint and return its metadata; the base stays in place.

    Args:
        folder: Folder of the checkpoint, created if necessary.
        merging: Result of the merge.
        fitted: Tensors of the fitted routers, see `MergedCheckpoint`.
        weights: Whether to store the merged weights. Otherwise the experts, which must stay in place, are merged
            whenever the checkpoint is loaded.

    Raises:
        CheckpointError: NaN or infinite weights.
        OSError: The files cannot be written.
    """
    parts = merging.parts
    tensors = tensors_of_parts(parts) | _under(ROUTER, fitted or {})
    for number, expert in enumerate(parts.statistics.tasks):
        v_adapter, v_task = parts.subspaces[expert]
        tensors |= _under(f"{SUBSPACE}/{number}", {"v_adapter": v_adapter, "v_task": v_task})
    check_finite(tensors, folder)
    _, base_metadata = load_tensors(merging.base)
    folder.mkdir(parents=True, exist_ok=True)
    metadata = MergedMetadata(
        architecture=parts.architecture,
        statistics=parts.statistics,
        recipe=parts.recipe,
        instructions=parts.instructions,
        expert_digests=parts.expert_digests,
        tasks_of_several={name: tasks for name, tasks in parts.tasks.items() if tasks != (name,)},
        action_steps=parts.action_steps,
        base=name_of_base(folder, merging.base),
        base_hash=base_metadata.tensor_hash,
        rescalers=parts.merged.rescalers,
        routers=tuple(sorted({name.partition("/")[0] for name in fitted or {}})),
        report=json.loads(merging.report.to_json()),
    )
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    metadata = write_folder(folder, tensors, metadata)
    if weights:
        return metadata
    checkpoints = {expert: name_of_base(folder, place) for expert, place in merging.checkpoints.items()}
    metadata = replace(metadata, checkpoints=checkpoints, merged_hash=metadata.tensor_hash)
    kept = {name: tensor for name, tensor in tensors.items() if _section_of(name) in BESIDE_WEIGHTS}
    return write_folder(folder, kept, metadata)


def load_merged(reference: str | Path) -> MergedCheckpoint:
    """Read and verify a merged checkpoint.

    Raises:
        PolicyError: It is not a merged checkpoint, truncated, of another hash than in its metadata, has NaN weights, a
            mask for another model, a base of another architecture, or refers to other experts than it was made of.
    """
    folder = locate(str(reference))
    metadata = MergedMetadata.verified(folder)
    base, base_metadata = load_tensors(base_folder(folder, metadata.base))
    check_architecture(folder, metadata.architecture, base_metadata.architecture)
    tensors = read_tensors(folder / WEIGHTS)
    check_finite(tensors, folder)
    if unknown := sorted(set(map(_section_of, tensors)) - set(BESIDE_WEIGHTS if metadata.checkpoints else SECTIONS)):
        raise CheckpointError(f"'{folder}': expected the tensors of a merged model, got {unknown[0]}")
    fitted = _section(tensors, ROUTER)
    with _placed(folder):
        subspaces = {expert: _subspaces(tensors, str(number)) for number, expert in enumerate(metadata.experts)}
        if metadata.checkpoints:
            return MergedCheckpoint(metadata, fitted, partial(_merge_again, folder, metadata, subspaces))
        parts = _parts(metadata, tensors, subspaces, base)
    return MergedCheckpoint(metadata, fitted, lambda: parts)


def _merge_again(folder: Path, metadata: MergedMetadata, subspaces: Mapping[str, Subspaces]) -> MergedWeights:
    with _placed(folder):
        experts = read_experts(metadata.expert_folder(folder, expert) for expert in metadata.experts)
        made = merge_parts(experts, metadata.recipe, metadata.instructions)
        for name in ("tasks", "statistics", "action_steps"):
            if getattr(made, name) != getattr(metadata, name):
                raise ExpertsDiffer(f"expected the {name.replace('_', ' ')} of its experts, got others in the metadata")
    # The last bits of singular vectors differ from processor to processor, so that they are stored.
    return replace(made, subspaces=subspaces)


@contextmanager
def _placed(folder: Path) -> Iterator[None]:
    """Name the checkpoint in errors about its content."""
    try:
        yield
    except (ExpertsDiffer, MaskMismatch, CheckpointError) as error:
        place = "" if str(error).startswith(f"'{folder}': ") else f"'{folder}': "
        raise type(error)(f"{place}{error}") from None


def tensors_of_parts(parts: MergedWeights) -> dict[str, Tensor]:
    """Return what a checkpoint stores of a merged model beside the base, by the tensors' names; nothing of routers."""
    bits = parts.recipe.stored_bits
    trunk = parts.trunk if bits is None else pack(parts.trunk_copy, bits)
    tensors = _merged_tensors(parts.merged) | _under(TRUNK, trunk)
    for number, expert in enumerate(parts.statistics.tasks):
        if bits is not None:
            tensors |= _under(f"{COPY}/{number}", pack(parts.copies[expert], bits))
        else:
            tensors |= _own_tensors(parts, expert, str(number))
    return tensors


def _own_tensors(parts: MergedWeights, expert: str, number: str) -> dict[str, Tensor]:
    tensors = _under(f"{HEAD}/{number}", parts.heads[expert])
    for weight, factors in parts.adapters.get(expert, {}).items():
        scaled = {"a": factors.a.float(), "b": factors.b.float() * factors.scale}
        tensors |= _under(f"{ADAPTER}/{number}/{weight}", scaled)
    return tensors


def _merged_tensors(merged: MergedTaskVectors) -> dict[str, Tensor]:
    vector = merged.vector
    if merged.recipe.bits is not None:
        vector = pack(merged.codes, merged.recipe.bits)
    elif merged.recipe.masks is MaskRule.SIGNS:
        vector = {name: delta.bfloat16() for name, delta in vector.items()}
    tensors = _under(TAU, vector)
    for number, expert in enumerate(merged.experts):
        if merged.masks:
            tensors |= _under(f"{MASK}/{number}", pack_mask(merged.masks[expert]))
        tensors |= _under(f"{SCALE}/{number}", merged.row_scales.get(expert, {}))
    return tensors | (_under(RESIDUAL, _merged_tensors(merged.residual)) if merged.residual else {})


def _merged(metadata: MergedMetadata, recipe: Recipe, tensors: Weights, base: Weights) -> MergedTaskVectors:
    vector: Weights = _section(tensors, TAU)
    codes: Copy = {}
    if recipe.bits is not None:
        codes = unpacked_copy(vector, base, recipe.bits, signed=recipe.masks is not MaskRule.SIGNS)
        vector = {name: matrix.dequantised().reshape(base[name].shape) for name, matrix in codes.items()}
    if not vector:
        return MergedTaskVectors(metadata.experts, replace(recipe, masks=MaskRule.NONE, rounds=1), {})
    if recipe.masks is MaskRule.EMR and set(metadata.rescalers) != set(metadata.experts):
        raise CheckpointError(f"expected a rescaler of each merged expert, got {dict(metadata.rescalers)}")
    masks: dict[str, Mask] = {}
    row_scales: dict[str, Weights] = {}
    for number, expert in enumerate(metadata.experts):
        if recipe.masks is not MaskRule.NONE:
            masks[expert] = unpack_mask(_section(tensors, f"{MASK}/{number}"))
            check_mask(masks[expert], vector)
        if recipe.masks is MaskRule.SIGNS:
            row_scales[expert] = _section(tensors, f"{SCALE}/{number}")
            check_row_scales(row_scales[expert], vector)
    residual = None
    if recipe.rounds > 1:
        residual = _merged(metadata, replace(recipe, rounds=recipe.rounds - 1), _section(tensors, RESIDUAL), base)
    return MergedTaskVectors(metadata.experts, recipe, vector, masks, metadata.rescalers, row_scales, residual, codes)


def _parts(
    metadata: MergedMetadata, tensors: Weights, subspaces: Mapping[str, Subspaces], base: Weights
) -> MergedWeights:
    numbered = {expert: str(number) for number, expert in enumerate(metadata.experts)}
    recipe = metadata.recipe
    bits = recipe.stored_bits
    merged = _merged(metadata, recipe, tensors, base)
    if merged.residual and (problem := difference(merged.vector, merged.residual.vector)):
        raise ExpertsDiffer(f"the second round is for another model: {problem}")
    trunk: Weights = _section(tensors, TRUNK)
    trunk_copy = {} if bits is None else unpacked_copy(trunk, base, bits)
    if trunk_copy:
        trunk = {name: weight.to(base[name].dtype) for name, weight in restored(trunk_copy, base)[1].items()}
    copies, adapters, heads = {}, {}, {}
    for expert, number in numbered.items():
        if bits is not None:
            copies[expert] = unpacked_copy(_section(tensors, f"{COPY}/{number}"), base, bits)
            adapters[expert], heads[expert] = restored(copies[expert], base)
            continue
        heads[expert] = _section(tensors, f"{HEAD}/{number}")
        if recipe.backbone is BackboneRule.SELECT or recipe.only:
            adapters[expert] = _adapters(tensors, number, base)
    return MergedWeights(
        architecture=metadata.architecture,
        statistics=metadata.statistics,
        tasks=metadata.tasks,
        instructions=metadata.instructions,
        recipe=recipe,
        base=base,
        merged=merged,
        trunk=trunk,
        adapters=adapters if any(adapters.values()) else {},
        heads=heads,
        subspaces=subspaces,
        expert_digests=metadata.expert_digests,
        copies=copies,
        trunk_copy=trunk_copy,
        action_steps=metadata.action_steps,
    )


def _adapters(tensors: Weights, number: str, base: Weights) -> dict[str, Factors]:
    section = _section(tensors, f"{ADAPTER}/{number}")
    adapters = {}
    for weight in sorted({name.rpartition("/")[0] for name in section}):
        if weight not in base or not {f"{weight}/a", f"{weight}/b"} <= section.keys():
            raise ExpertsDiffer(f"expected both factors of a weight of the base, got {weight}")
        a, b, shape = section[f"{weight}/a"], section[f"{weight}/b"], base[weight].shape
        if a.shape[0] != b.shape[1] or a[0].numel() * b.shape[0] != shape.numel():
            raise ExpertsDiffer(
                f"expected factors of shape {tuple(shape)} for {weight}, got {(*b.shape,)}, {(*a.shape,)}"
            )
        adapters[weight] = Factors(a, b, 1.0, shape)
    return adapters


def _subspaces(tensors: Weights, number: str) -> Subspaces:
    section = _section(tensors, f"{SUBSPACE}/{number}")
    if section.keys() != {"v_adapter", "v_task"}:
        raise CheckpointError(f"expected the value projections of expert {number}, got {', '.join(section) or 'none'}")
    return section["v_adapter"], section["v_task"]


def _section_of(name: str) -> str:
    return name.partition("/")[0]


def _under(prefix: str, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {f"{prefix}/{name}": tensor for name, tensor in tensors.items()}


def _section(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {
        name.removeprefix(f"{prefix}/"): tensor for name, tensor in tensors.items() if name.startswith(f"{prefix}/")
    }
