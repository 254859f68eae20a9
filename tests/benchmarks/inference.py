"""Chunks per second of a merged policy on the CPU: one thread, random weights, nine experts in every batch."""

import tempfile
import time
from pathlib import Path

from tests.benchmarks.shared import table_of

BATCHES = (1, 8, 32)
EXPERTS = 9
SECONDS = 4.0
"""Duration of a measurement, per batch size (s)."""


def measure() -> list[dict[str, float]]:
    """Query an oracle-routed merged policy of the `tiny` size, with episodes of one expert and of all in turn."""
    from robogauntlet.policies.contract import Query
    from robogauntlet.policies.mergevla.checkpoints.merged_model import MergedModel
    from robogauntlet.policies.mergevla.network.config import TINY
    from robogauntlet.policies.mergevla.policies.merged_policy import MergedPolicy
    from robogauntlet.policies.mergevla.routing.catalog import router
    from tests.policies.mergevla.experts import merging, save_experts
    from tests.policies.mergevla.shared import query

    tasks = [f"null/Task{number}" for number in range(EXPERTS)]
    with tempfile.TemporaryDirectory() as folder:
        made = merging(save_experts(Path(folder), tasks, TINY), instructions=dict.fromkeys(tasks, "reach"))
    policy = MergedPolicy(MergedModel(made.parts), router("oracle"))

    def queries(size: int, experts: int) -> list[Query]:
        return [query(seed, TINY.image_size, task=tasks[seed % experts]) for seed in range(size)]

    rows: list[dict[str, float]] = []
    for experts in (1, EXPERTS):
        for size in BATCHES if experts == 1 else BATCHES[1:]:
            batch = queries(size, experts)
            policy.act(batch)
            start, chunks = time.perf_counter(), 0
            while (passed := time.perf_counter() - start) < SECONDS:
                chunks += len(policy.act(batch))
            rate = chunks / passed
            one_by_one = rows[0]["chunks_per_s"] if rows else rate
            row = {"experts": min(experts, size), "batch": size}
            rows.append({**row, "chunks_per_s": rate, "relative": rate / one_by_one})
    columns = {"experts in the batch": "{experts}", "batch": "{batch}", "chunks/s": "{chunks_per_s:.1f}"}
    table_of(rows, columns | {"relative to one by one": "{relative:.2f}x"})
    return rows
