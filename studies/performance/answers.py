"""CPU time of an answer of the `tiny` network, and of its matrix multiplications and convolutions alone: one thread."""

import time
from collections.abc import Callable
from statistics import median
from typing import TYPE_CHECKING, Any

from studies.percent import few
from studies.performance.inference import expert_and_merged, queries
from studies.shared import table_of

if TYPE_CHECKING:
    from robogauntlet.policies.contract import Policy

ANSWERS = 200


def measure() -> list[dict[str, Any]]:
    """Query an expert and an oracle-routed merged policy, of random weights, with one observation."""
    policies = dict(zip(("expert", "merged"), expert_and_merged(), strict=True))
    rows = [{"policy": name, **_costs(policy)} for name, policy in policies.items()]
    columns = {"policy": "{policy}", "CPU ms per answer": "{answer_ms:.2f}"}
    table_of(rows, columns | {"of it matrix multiplications and convolutions alone": "{alone_ms:.2f}"})
    return rows


def _costs(policy: "Policy") -> dict[str, float]:
    """CPU time of an answer, and of its matrix multiplications and convolutions done again, taken in turn (ms)."""
    import torch
    from torch import nn
    from torch.nn.modules.module import register_module_forward_hook

    asked = queries(1, 1)

    calls: list[tuple[nn.Module, torch.Tensor]] = []

    def note(module: nn.Module, inputs: tuple[torch.Tensor, ...], output: object) -> None:
        if isinstance(module, nn.Linear | nn.Conv2d):
            calls.append((module, inputs[0]))

    policy.act(asked)
    noting = register_module_forward_hook(note)
    policy.act(asked)
    noting.remove()

    @torch.inference_mode()
    def alone() -> None:
        for module, given in calls:
            module.forward(given)

    taken: dict[str, list[float]] = {"answer_ms": [], "alone_ms": []}
    work: dict[str, Callable[[], object]] = {"answer_ms": lambda: policy.act(asked), "alone_ms": alone}
    for _ in range(few(ANSWERS)):
        for name, function in work.items():
            start = time.process_time()
            function()
            taken[name].append(1000.0 * (time.process_time() - start))
    return {name: median(times) for name, times in taken.items()}
