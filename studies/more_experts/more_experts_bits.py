"""Twenty experts of Meta-World kept apart, and merged, at equal precision: bits, bytes and success.

`META_WORLD=FOLDER python -m studies more_experts --measure more_experts_bits` (default `runs/meta-world`) merges and
plays the experts of `studies/more_experts/meta_world.sh`. What is finished in the folder is kept.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from robogauntlet_mergevla.checkpoints.metadata import WEIGHTS
from robogauntlet_mergevla.options import expert_folders
from studies.merging.operators import cell, outcomes_of, point
from studies.more_experts.more_experts import folder_of_experts, folder_of_merge, in_order, merged
from studies.shared import kilobytes, merged_policy, play_policies, table_of
from studies.tables import episodes_of, write_episodes

EXPERTS, OWN = "experts", "own types"
COPIES: dict[str, Any] = {"operator": "none", "masks": "none"}
WAYS: dict[str, tuple[dict[str, Any], tuple[str | int, ...]]] = {
    "copies, not merged": (COPIES, (OWN, 8, 4, 3, 2)),
    "signs-2": ({"operator": "magnitude", "masks": "signs", "rounds": 2}, (OWN, 8, 4, 3)),
    "ties-published-s": ({"operator": "ties-published"}, (OWN, 4, 3)),
}
"""Names as in `operators`, to recipe and bits per entry. Own types: 16 and 32-bit numbers; of copies, the experts."""
ALL_BITS = (OWN, 8, 4, 3, 2)
SEEDS = 10
EPISODE = ("policy", "task", "seed", "status")
COLUMNS = {"way": "{way}", **{bits if bits == OWN else f"{bits} bits": f"{{bits_{bits}}}" for bits in ALL_BITS}}


def measure() -> list[dict[str, Any]]:
    """A row for each way; writes the episodes beside the rows."""
    from robogauntlet_mergevla.checkpoints.expert_checkpoint import read_tensors

    folder = folder_of_experts()
    experts = expert_folders(folder / "experts")
    tasks = in_order(experts)
    policies = {EXPERTS: {"kind": "mergevla-experts", "options": {"folder": str(folder / "experts")}}}
    sizes = {EXPERTS: sum(kilobytes(read_tensors(expert / WEIGHTS)) for expert in experts.values()) / len(experts)}
    for way, (recipe, all_bits) in WAYS.items():
        for bits in all_bits:
            if (name := named(way, bits)) != EXPERTS:
                sizes[name] = float(merged(folder, tasks, name, at(recipe, bits))["kilobytes"].replace(",", ""))
                policies[name] = merged_policy(folder_of_merge(folder, len(tasks), name))
    frame = play_policies(folder, "bits", policies, tasks, SEEDS, EPISODE)
    write_episodes("more_experts_bits", frame, ("policy", "task", "seed"))
    rows = rows_of(frame, sizes)
    table_of(rows, COLUMNS)
    return rows


def named(way: str, bits: str | int) -> str:
    """The policy of a way: `experts` for copies in their own types."""
    first = EXPERTS if WAYS[way][0] is COPIES else way
    return first if bits == OWN else f"{way.partition(',')[0]}-{bits}-bits"


def at(recipe: Mapping[str, Any], bits: str | int) -> dict[str, Any]:
    """A recipe with all that it stores at `bits` bits."""
    if bits == OWN:
        return {**recipe}
    return {**recipe, "options": {"bits": bits}} if recipe is COPIES else {**recipe, "bits": bits}


def counted(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The rows again, from the kept episodes; sizes are taken from the rows."""
    sizes = {name: found["kilobytes"] for row in rows for name, found in row["points"].items()}
    return rows_of(episodes_of("more_experts", "more_experts_bits"), sizes)


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
