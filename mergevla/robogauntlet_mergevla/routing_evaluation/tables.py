"""The results of a routing study as tables and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from statistics import fmean
from typing import TYPE_CHECKING, Any

from robogauntlet.results.analysis.routing import Confusion, Detection, plain_task
from robogauntlet.results.report.formatting import NOTHING, TextTable, percent, seconds, share

if TYPE_CHECKING:
    from robogauntlet_mergevla.routing_evaluation.evaluation import RouterResult, RoutingStudy, UnknownResult

INSTRUCTION = {True: "read", False: "hidden"}
"""Whether the router sees the instruction, as text."""


def router_table(study: RoutingStudy) -> TextTable:
    """A row per router, with and without the instruction."""
    pairs = study.routers[0].quality.scene_pairs
    header = ("router", "instruction", "accuracy", *(",\n".join(map(plain_task, pair.tasks)) for pair in pairs))
    header += ("ECE", "Brier", "passes", "latency", "in\npasses")
    return TextTable(header, tuple(map(_router_row, study.routers)), 2)


def split(table: TextTable, columns: int) -> tuple[TextTable, TextTable]:
    """Split the router table into one without and one with only the columns of tasks that share a scene."""

    def chosen(places: Sequence[int]) -> TextTable:
        header, *rows = (tuple(row[place] for place in places) for row in (table.header, *table.rows))
        return TextTable(header, tuple(rows), table.labels)

    end = 3 + columns
    return chosen([0, 1, 2, *range(end, len(table.header))]), chosen([0, 1, *range(3, end)])


def confusions(confusion: Confusion) -> list[str]:
    """Wrong choices, most frequent first: `pybullet/PandaPickAndPlace-v3 -> pybullet/PandaPush-v3: 12`."""
    wrong = [
        (count, task, inferred)
        for task, counts in zip(confusion.true, confusion.counts, strict=True)
        for inferred, count in zip(confusion.inferred, counts, strict=True)
        if count and inferred != task
    ]
    wrong.sort(key=lambda item: (-item[0], item[1:]))
    return [f"{task} -> {inferred}: {count}" for count, task, inferred in wrong]


def unknown_table(unknown: UnknownResult) -> TextTable:
    """A row per left-out task, and their means."""
    header = ("left out", "AUROC", "FPR at 95 %", "rejected", "false alarms")
    lines = {task: _shares(detection) for task, detection in unknown.by_task.items()}
    lines["mean"] = tuple(map(fmean, zip(*lines.values(), strict=True)))
    rows = ((name, f"{auroc:.3f}", *map(percent, shares)) for name, (auroc, *shares) in lines.items())
    return TextTable(header, tuple(rows), 1)


def as_json(study: RoutingStudy) -> dict[str, Any]:
    """The study in JSON types; metrics have the names of a run's `summary.json`."""
    request = study.request
    return {
        "checkpoint": request.checkpoint,
        "digest": study.digest,
        "view": asdict(study.view),
        "seeds": {"start": request.seeds[0], "count": len(request.seeds)},
        "tasks": list(study.tasks),
        "skipped": study.skipped,
        "pass_s": study.pass_s,
        "routers": [asdict(result) for result in study.routers],
        "unknown_tasks": [asdict(result) for result in study.unknown],
    }


def _router_row(result: RouterResult) -> tuple[str, ...]:
    quality, calibration = result.quality, result.quality.calibration
    return (
        result.router,
        INSTRUCTION[result.sees_instruction],
        share(quality.accuracy),
        *(share(pair.accuracy) for pair in quality.scene_pairs),
        *((f"{calibration.expected_error:.3f}", f"{calibration.brier:.3f}") if calibration else (NOTHING, NOTHING)),
        str(result.passes),
        seconds(quality.latency.median_s),
        f"{result.latency_in_passes:.2f}",
    )


def _shares(detection: Detection) -> tuple[float, ...]:
    assert detection.rejected is not None
    assert detection.false_alarms is not None
    rejected, false_alarms = (rate.successes / rate.trials for rate in (detection.rejected, detection.false_alarms))
    return detection.auroc, detection.false_positives, rejected, false_alarms
