"""Twenty experts of Meta-World kept apart, and merged, at equal precision: bits, bytes and success.

`META_WORLD=FOLDER python -m studies more_experts --measure more_experts_bits` (default `runs/meta-world`) merges and
plays the experts of `studies/more_experts/meta_world.sh`. What is finished in the folder is kept.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robogauntlet_mergevla.options import expert_folders
from studies.merging.bits import COLUMNS, EXPERTS, policies_of, rows_of, sizes_in
from studies.more_experts.more_experts import folder_of_experts, folder_of_merge, in_order
from studies.shared import play_policies, table_of
from studies.tables import episodes_of, write_episodes

SEEDS = 10
EPISODE = ("policy", "task", "seed", "status")


def measure() -> list[dict[str, Any]]:
    """A row for each way; writes the episodes beside the rows."""
    folder = folder_of_experts()
    experts = expert_folders(folder / "experts")
    tasks = in_order(experts)
    policies, sizes = policies_of(folder_of_merge(folder, len(tasks), "bits"), [experts[task] for task in tasks])
    policies[EXPERTS] = {"kind": "mergevla-experts", "options": {"folder": str(folder / "experts")}}
    frame = play_policies(folder, "bits", policies, tasks, SEEDS, EPISODE)
    write_episodes("more_experts_bits", frame, ("policy", "task", "seed"))
    rows = rows_of(frame, sizes)
    table_of(rows, COLUMNS)
    return rows


def counted(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The rows again, from the kept episodes; sizes are taken from the rows."""
    return rows_of(episodes_of("more_experts", "more_experts_bits"), sizes_in(rows))
