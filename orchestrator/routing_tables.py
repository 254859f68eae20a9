"""What a study of routers found, as tables and as JSON."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from results.report.merging import share
from results.report.text import NOTHING, TextTable, percent, seconds
from results.routing import SCENE_PAIRS, Rate, plain_task

if TYPE_CHECKING:
    from orchestrator.routing_study import RoutingStudy
    from policies.mergevla.routing.study import Count, Detection, LeftOut, Study
    from policies.mergevla.routing.trials import Judged

INSTRUCTION = {True: "read", False: "hidden"}
"""What the router does with it."""


def router_table(study: RoutingStudy) -> TextTable:
    """A line per router, with the instruction and without."""
    pairs = scene_pairs(study.tasks)
    header = ("router", "instruction", "accuracy", *(",\n".join(map(plain_task, pair)) for pair in pairs))
    header += ("ECE", "Brier", "passes", "latency", "in\npasses")
    return TextTable(header, tuple(_router_row(one, pairs) for one in study.judgement.routers), 2)


def split(table: TextTable, columns: int) -> tuple[TextTable, TextTable]:
    """The table of routers without the columns of tasks that share a scene, and these by themselves.

    Args:
        table: From `router_table`.
        columns: How many these are.
    """
    after = 3 + columns
    without = TextTable(
        (*table.header[:3], *table.header[after:]), tuple((*row[:3], *row[after:]) for row in table.rows), table.labels
    )
    alone = TextTable(
        (*table.header[:2], *table.header[3:after]),
        tuple((*row[:2], *row[3:after]) for row in table.rows),
        table.labels,
    )
    return without, alone


def confusions(study: Study) -> list[str]:
    """Misrouted sightings, most first: `pybullet/PandaPickAndPlace-v3 -> pybullet/PandaPush-v3: 12`."""
    wrong = [
        (count, task, chosen)
        for task, row in study.confusion.items()
        for chosen, count in row.items()
        if count and chosen != task
    ]
    return [f"{task} -> {chosen}: {count}" for count, task, chosen in sorted(wrong, key=lambda one: (-one[0], one[1:]))]


def unknown_table(left_out: LeftOut) -> TextTable:
    """A line per task that was left out, and their means."""
    header = ("left out", "AUROC", "FPR at 95 %", "rejected", "false alarms")
    found: dict[str, Detection | LeftOut] = {**left_out.by_task, "mean": left_out}
    return TextTable(header, tuple((name, *_detected(one)) for name, one in found.items()), 1)


def scene_pairs(tasks: Sequence[str]) -> list[tuple[str, ...]]:
    """Those of the tasks that share a scene, see `results.routing.SCENE_PAIRS`."""
    names = {plain_task(task): task for task in tasks}
    return [tuple(names[name] for name in pair) for pair in SCENE_PAIRS if names.keys() >= set(pair)]


def as_json(study: RoutingStudy) -> dict[str, Any]:
    """All of it in JSON's own types."""
    pairs, order = scene_pairs(study.tasks), study.order
    return {
        "checkpoint": order.checkpoint,
        "digest": study.digest,
        "view": asdict(study.view),
        "seeds": {"start": order.seeds[0], "count": len(order.seeds)},
        "tasks": list(study.tasks),
        "skipped": study.skipped,
        "pass_s": study.judgement.pass_s,
        "routers": [_router_json(one, pairs) for one in study.judgement.routers],
        "unknown_tasks": [
            {"router": one.router, "sees_instruction": one.sees_instruction, **asdict(one.left_out)}
            for one in study.unknown
        ],
    }


def _router_row(one: Judged, pairs: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    study, calibrated = one.study, one.study.calibrated
    return (
        one.router,
        INSTRUCTION[one.sees_instruction],
        share(_rate([study.total])),
        *(share(_rate(study.by_task[task] for task in pair)) for pair in pairs),
        *((f"{calibrated.expected_error:.3f}", f"{calibrated.brier:.3f}") if calibrated else (NOTHING, NOTHING)),
        str(one.passes),
        seconds(study.latency.median_s if study.latency else None),
        f"{one.relative_latency:.2f}",
    )


def _router_json(one: Judged, pairs: Sequence[tuple[str, ...]]) -> dict[str, Any]:
    study = one.study
    return {
        "router": one.router,
        "sees_instruction": one.sees_instruction,
        "passes": one.passes,
        "accuracy": asdict(_rate([study.total])),
        "by_task": {task: asdict(_rate([count])) for task, count in study.by_task.items()},
        "scene_pairs": [
            {"tasks": list(pair), "accuracy": asdict(_rate(study.by_task[task] for task in pair))} for pair in pairs
        ],
        "calibration": asdict(study.calibrated) if study.calibrated else None,
        "rejected": study.rejected,
        "latency": asdict(study.latency) if study.latency else None,
        "latency_in_passes": one.relative_latency,
        "confusion": {task: dict(row) for task, row in study.confusion.items()},
    }


def _rate(counts: Iterable[Count]) -> Rate:
    found = list(counts)
    return Rate.of(sum(count.right for count in found), sum(count.trials for count in found))


def _detected(found: Detection | LeftOut) -> tuple[str, ...]:
    shares = (found.false_positive_rate, found.rejected, found.false_alarms)
    return f"{found.auroc:.3f}", *map(percent, shares)
