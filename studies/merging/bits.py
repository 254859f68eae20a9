"""Ways of keeping experts, in types of their own and with few bits per entry: recipes, sizes, and a row for each way.

`more_experts_bits` and `arms_bits` play them.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from studies.merging.operators import cell, outcomes_of, point
from studies.shared import kilobytes, merged_policy

EXPERTS, OWN = "experts", "own types"
COPIES: dict[str, Any] = {"operator": "none", "masks": "none"}
WAYS: dict[str, tuple[dict[str, Any], tuple[str | int, ...]]] = {
    "copies, not merged": (COPIES, (OWN, 8, 4, 3, 2)),
    "signs-2": ({"operator": "magnitude", "masks": "signs", "rounds": 2}, (OWN, 8, 4, 3)),
    "ties-published-s": ({"operator": "ties-published"}, (OWN, 4, 3)),
}
"""Names as in `operators`, to recipe and bits per entry. Own types: 16 and 32-bit numbers; of copies, the experts."""
ALL_BITS = (OWN, 8, 4, 3, 2)
COLUMNS = {"way": "{way}", **{bits if bits == OWN else f"{bits} bits": f"{{bits_{bits}}}" for bits in ALL_BITS}}


def policies_of(folder: Path, experts: Sequence[Path]) -> tuple[dict[str, dict[str, Any]], dict[str, float]]:
    """Make what is missing of the ways in `folder`: policies but `EXPERTS`, and their storage per expert (kB).

    What is made does not depend on the order of the experts' folders.
    """
    from robogauntlet_mergevla.checkpoints.expert_checkpoint import read_tensors
    from robogauntlet_mergevla.checkpoints.metadata import WEIGHTS

    policies: dict[str, dict[str, Any]] = {}
    sizes = {EXPERTS: sum(kilobytes(read_tensors(expert / WEIGHTS)) for expert in experts) / len(experts)}
    for way, (recipe, all_bits) in WAYS.items():
        for bits in all_bits:
            if (name := named(way, bits)) != EXPERTS:
                sizes[name] = _merge(folder / name, experts, at(recipe, bits))
                policies[name] = merged_policy(folder / name)
    return policies, sizes


def _merge(out: Path, experts: Sequence[Path], recipe: Mapping[str, Any]) -> float:
    """Merge experts into a folder, unless that is done; return the storage per expert (kB)."""
    from robogauntlet_mergevla.checkpoints.merge_experts import merge_experts, read_experts
    from robogauntlet_mergevla.checkpoints.merged_checkpoint import save_merged, tensors_of_parts
    from robogauntlet_mergevla.merging.recipe import Recipe

    size = out / "kilobytes.json"
    if not size.exists():
        merging = merge_experts(read_experts(experts), Recipe(**recipe))
        save_merged(out, merging, {})
        size.write_text(json.dumps(round(kilobytes(tensors_of_parts(merging.parts)) / len(experts))))
    return float(json.loads(size.read_text()))


def named(way: str, bits: str | int) -> str:
    """The policy of a way: `experts` for copies in their own types."""
    first = EXPERTS if WAYS[way][0] is COPIES else way
    return first if bits == OWN else f"{way.partition(',')[0]}-{bits}-bits"


def at(recipe: Mapping[str, Any], bits: str | int) -> dict[str, Any]:
    """A recipe with all that it stores at `bits` bits."""
    if bits == OWN:
        return {**recipe}
    return {**recipe, "options": {"bits": bits}} if recipe is COPIES else {**recipe, "bits": bits}


def sizes_in(rows: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """The storage of each policy in rows that were made before (kB)."""
    return {name: found["kilobytes"] for row in rows for name, found in row["points"].items()}


def rows_of(frame: pd.DataFrame, sizes: Mapping[str, float]) -> list[dict[str, Any]]:
    """A row for each way: its share of the experts' success and kB per task, by bits.

    Args:
        frame: A row per episode: policy, task, seed, status.
        sizes: Policy to its storage per task beside the base.
    """
    table = outcomes_of(frame)
    rows = []
    for way, (_, all_bits) in WAYS.items():
        names = {bits: named(way, bits) for bits in all_bits}
        points = {name: point(table, name, sizes[name]) for name in names.values()}
        cells = {f"bits_{bits}": cell(points[names[bits]]) if bits in names else "" for bits in ALL_BITS}
        rows.append({"way": way, "points": points, **cells})
    return rows
