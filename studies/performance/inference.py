"""Chunks of the `tiny` network per second on the CPU, one by one and in batches: one thread, random weights."""

import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studies.percent import few
from studies.shared import table_of

if TYPE_CHECKING:
    from robogauntlet.policies.contract import Policy, Query

BATCHES = (1, 8, 32)
EXPERTS = 9
TASKS = tuple(f"null/Task{number}" for number in range(EXPERTS))
SECONDS = few(400) / 100
"""Duration of a measurement, per batch size (s)."""


def expert_and_merged() -> "tuple[Policy, Policy]":
    """An expert, and an oracle-routed policy merged from the experts of all tasks."""
    from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
    from robogauntlet_mergevla.network.config import TINY
    from robogauntlet_mergevla.policies.merged_policy import MergedPolicy
    from robogauntlet_mergevla.policies.single_policy import MergeVLAPolicy
    from robogauntlet_mergevla.routing.catalog import router
    from tests.mergevla.experts import merging, save_experts

    with tempfile.TemporaryDirectory() as folder:
        folders = save_experts(Path(folder), TASKS, TINY)
        made = merging(folders, instructions=dict.fromkeys(TASKS, "reach"))
        return MergeVLAPolicy(folders[0]), MergedPolicy(MergedModel(made.parts), router("oracle"))


def queries(size: int, experts: int) -> "list[Query]":
    """Queries of episodes of so many tasks in turn."""
    from robogauntlet_mergevla.network.config import TINY
    from tests.mergevla.shared import query

    return [query(seed, TINY.image_size, task=TASKS[seed % experts]) for seed in range(size)]


def measure() -> list[dict[str, Any]]:
    """Query the merged policy one by one and in batches, of episodes of one task and of all in turn."""
    _, merged = expert_and_merged()
    rows: list[dict[str, Any]] = []
    for experts in (1, EXPERTS):
        for size in BATCHES if experts == 1 else BATCHES[1:]:
            batch = queries(size, experts)
            together = merged.act(batch)
            alone = [merged.act([query])[0] for query in batch]
            apart = [np.abs(one.actions - other.actions).max() for one, other in zip(together, alone, strict=True)]
            start, chunks = time.perf_counter(), 0
            while (passed := time.perf_counter() - start) < SECONDS:
                chunks += len(merged.act(batch))
            rate = chunks / passed
            one_by_one = rows[0]["chunks_per_s"] if rows else rate
            row = {"experts": min(experts, size), "batch": size, "equal": apart.count(0.0), "apart": float(max(apart))}
            rows.append({**row, "chunks_per_s": rate, "relative": rate / one_by_one})
    columns = {"experts in the batch": "{experts}", "batch": "{batch}", "chunks/s": "{chunks_per_s:.1f}"}
    columns |= {"relative to one by one": "{relative:.2f}x", "chunks equal to the bit": "{equal} of {batch}"}
    table_of(rows, columns | {"largest difference of an action": "{apart:.1e}"})
    return rows
