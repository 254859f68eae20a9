"""What answers of the `tiny` network cost on the CPU: one thread, random weights, experts of nine tasks."""

import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

from tests.benchmarks.shared import table_of

if TYPE_CHECKING:
    from robogauntlet.policies.contract import Policy, Query

BATCHES = (1, 8, 32)
EXPERTS = 9
SECONDS = 4.0
"""Duration of a measurement, per batch size (s)."""
ANSWERS = 200
"""Answers to one query whose time is measured."""


def measure() -> list[dict[str, Any]]:
    """Query an expert and an oracle-routed merged policy one by one, and the latter in batches.

    Batches are of episodes of one task, and of all in turn.
    """
    from robogauntlet.policies.mergevla.checkpoints.merged_model import MergedModel
    from robogauntlet.policies.mergevla.network.config import TINY
    from robogauntlet.policies.mergevla.policies.merged_policy import MergedPolicy
    from robogauntlet.policies.mergevla.policies.single_policy import MergeVLAPolicy
    from robogauntlet.policies.mergevla.routing.catalog import router
    from tests.policies.mergevla.experts import merging, save_experts
    from tests.policies.mergevla.shared import query

    tasks = [f"null/Task{number}" for number in range(EXPERTS)]
    with tempfile.TemporaryDirectory() as folder:
        folders = save_experts(Path(folder), tasks, TINY)
        expert = MergeVLAPolicy(folders[0])
        made = merging(folders, instructions=dict.fromkeys(tasks, "reach"))
    merged = MergedPolicy(MergedModel(made.parts), router("oracle"))

    def queries(size: int, experts: int) -> list["Query"]:
        return [query(seed, TINY.image_size, task=tasks[seed % experts]) for seed in range(size)]

    policies: dict[str, Policy] = {"expert": expert, "merged": merged}
    answers = [{"policy": name, **_answer(policy, queries(1, 1))} for name, policy in policies.items()]
    columns = {"policy": "{policy}", "CPU ms per answer": "{answer_ms:.2f}"}
    table_of(answers, columns | {"of it matrix multiplications and convolutions alone": "{alone_ms:.2f}"})
    print()

    rows: list[dict[str, Any]] = []
    for experts in (1, EXPERTS):
        for size in BATCHES if experts == 1 else BATCHES[1:]:
            batch = queries(size, experts)
            merged.act(batch)
            start, chunks = time.perf_counter(), 0
            while (passed := time.perf_counter() - start) < SECONDS:
                chunks += len(merged.act(batch))
            rate = chunks / passed
            one_by_one = rows[0]["chunks_per_s"] if rows else rate
            row = {"experts": min(experts, size), "batch": size}
            rows.append({**row, "chunks_per_s": rate, "relative": rate / one_by_one})
    columns = {"experts in the batch": "{experts}", "batch": "{batch}", "chunks/s": "{chunks_per_s:.1f}"}
    table_of(rows, columns | {"relative to one by one": "{relative:.2f}x"})
    return answers + rows


def _answer(policy: "Policy", queries: "Sequence[Query]") -> dict[str, float]:
    """CPU time of an answer, and of its matrix multiplications and convolutions done again, taken in turn (ms)."""
    import torch
    from torch import nn
    from torch.nn.modules.module import register_module_forward_hook

    calls: list[tuple[nn.Module, torch.Tensor]] = []

    def note(module: nn.Module, inputs: tuple[torch.Tensor, ...], output: object) -> None:
        if isinstance(module, nn.Linear | nn.Conv2d):
            calls.append((module, inputs[0]))

    policy.act(queries)
    noting = register_module_forward_hook(note)
    policy.act(queries)
    noting.remove()

    @torch.inference_mode()
    def alone() -> None:
        for module, given in calls:
            module.forward(given)

    taken: dict[str, list[float]] = {"answer_ms": [], "alone_ms": []}
    work: dict[str, Callable[[], object]] = {"answer_ms": lambda: policy.act(queries), "alone_ms": alone}
    for _ in range(ANSWERS):
        for name, function in work.items():
            start = time.process_time()
            function()
            taken[name].append(1000.0 * (time.process_time() - start))
    return {name: median(times) for name, times in taken.items()}
