"""Chunks per second of a merged policy on the CPU: one thread, random weights, nine experts in every batch."""

import tempfile
import time
from pathlib import Path

from tests.benchmarks.shared import table

BATCHES = (1, 8, 32)
EXPERTS = 9
SECONDS = 4.0
"""Of measuring, per batch size."""


def measure() -> list[dict[str, object]]:
    """Ask a told merged policy of the `tiny` size for chunks, with episodes of one expert and of all by turns."""
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

    found: list[dict[str, object]] = []
    for experts in (1, EXPERTS):
        for size in BATCHES if experts == 1 else BATCHES[1:]:
            asked = queries(size, experts)
            policy.act(asked)
            start, chunks = time.perf_counter(), 0
            while (passed := time.perf_counter() - start) < SECONDS:
                chunks += len(policy.act(asked))
            found.append({"experts": min(experts, size), "batch": size, "chunks_per_s": chunks / passed})
    alone = found[0]["chunks_per_s"]
    table(
        ("experts in the batch", "batch", "chunks/s", "to one by one"),
        [(experts, batch, f"{rate:.1f}", f"{rate / alone:.2f}x") for experts, batch, rate in map(dict.values, found)],
    )
    return found
