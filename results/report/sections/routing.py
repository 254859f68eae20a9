"""How well policies infer their task: accuracy, confusion and calibration of routers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from robogauntlet.results.analysis.routing import Calibration, Confusion, Router, router_of
from robogauntlet.results.report.blocks import (
    Block,
    Charts,
    Heading,
    HeatCell,
    HeatMap,
    Line,
    LineChart,
    Paragraph,
    Point,
    Table,
    Terms,
)
from robogauntlet.results.report.formatting import (
    NOTHING,
    TextTable,
    count,
    counted,
    percent,
    seconds,
    share,
    short_task,
)
from robogauntlet.results.report.section import Page, Section, Source

COLUMNS = (
    *("simulator", "task", "policy_digest", "axis", "severity"),
    *("inferred_task", "routing_scores", "unknown_score", "rejected", "routing_s"),
)
"""Fields of the record that are needed."""
TERMS = {
    "accuracy": "Share of episodes in which the task was inferred correctly.",
    "calibration": "Calibration error: mean difference of accuracy and the probability of the chosen task. "
    "Brier score: mean squared distance of all probabilities from the truth, 0 to 2. Both only if the scores are "
    "log-probabilities.",
    "latency": "Time to infer the task, once per episode.",
}


@dataclass(frozen=True, slots=True)
class RoutedPolicy:
    """A policy that infers its task."""

    policy: str
    router: Router


def build_routing(source: Source) -> tuple[RoutedPolicy, ...] | None:
    """The routers of a run under its first condition, in the order of the plan; None if no task was inferred.

    The oracle-routed policy of a suite's `merging` is left out: it is given the task.
    """
    if not source.rows["inferred_task"].notna().any():
        return None
    shown = source.tables.conditions[0]
    rows = source.rows
    rows = rows.loc[(rows["axis"].astype(str) == shown.axis) & (rows["severity"] == shown.severity)]
    place = {name: number for number, name in enumerate(dict.fromkeys(cell.task for cell in source.document.plan))}
    rows = rows.sort_values("task", key=lambda names: names.astype(str).map(place), kind="stable")
    roles, found = source.document.suite.merging, []
    for policy, digest in {cell.policy: cell.policy_digest for cell in source.document.plan}.items():
        if roles is not None and policy == roles.oracle_routed:
            continue
        router = router_of(rows.loc[rows["policy_digest"].astype(str) == digest])
        found += [] if router is None else [RoutedPolicy(policy, router)]
    return tuple(found) or None


def router_table(found: Sequence[RoutedPolicy]) -> TextTable:
    """Accuracy of each router, also on tasks that share a scene, with calibration, latency and rejection."""
    routers = [one.router for one in found]
    calibrations = [router.calibration for router in routers]
    detections = [router.detection for router in routers]
    lines: list[tuple[str, ...]] = [("accuracy", *(share(router.accuracy) for router in routers))]
    lines += [
        (f"accuracy in {name}", *(share(dict(router.simulators).get(name)) for router in routers))
        for name in dict.fromkeys(name for router in routers for name, _ in router.simulators)
    ]
    for tasks in dict.fromkeys(pair.tasks for router in routers for pair in router.scene_pairs):
        names = " and ".join(map(short_task, tasks))
        by_pair = [{pair.tasks: pair for pair in router.scene_pairs}.get(tasks) for router in routers]
        lines.append((f"accuracy, {names}", *(share(pair.accuracy) if pair else NOTHING for pair in by_pair)))
        taken = (count(pair.mistaken) if pair else NOTHING for pair in by_pair)
        lines.append(("confused with each other", *taken))
    lines += [
        ("calibration error", *(NOTHING if c is None else f"{c.expected_error:.3f}" for c in calibrations)),
        ("Brier score", *(NOTHING if c is None else f"{c.brier:.3f}" for c in calibrations)),
        ("latency, median", *(seconds(router.latency.median_s) for router in routers)),
        ("latency, 95th percentile", *(seconds(router.latency.p95_s) for router in routers)),
        ("known tasks rejected", *(share(router.rejected) for router in routers)),
        ("unknown tasks rejected", *(share(d.rejected) if d else NOTHING for d in detections)),
        ("unknown tasks, AUROC", *(f"{d.auroc:.3f}" if d else NOTHING for d in detections)),
        ("unknown tasks, FPR at 95 %", *(percent(d.false_positives) if d else NOTHING for d in detections)),
    ]
    shown = tuple(line for line in lines if set(line[1:]) != {NOTHING})
    return TextTable(("", *(one.policy for one in found)), shown, 1)


def confusion_table(confusion: Confusion) -> TextTable:
    """Numbers of episodes by true task (rows) and inferred task (columns)."""
    header = ("true task, inferred:", *map(short_task, confusion.inferred))
    lines = zip(confusion.true, confusion.counts, strict=True)
    return TextTable(header, tuple((short_task(task), *map(count, counts)) for task, counts in lines), 1)


def calibration_table(calibration: Calibration) -> TextTable:
    """Accuracy by confidence."""
    lines = tuple(
        (f"{b.low:.2f} to {b.high:.2f}", f"{b.confidence:.2f}", share(b.accuracy), count(b.episodes))
        for b in calibration.bins
    )
    return TextTable(("confidence", "mean", "accuracy", "episodes"), lines, 1)


def _blocks(found: Sequence[RoutedPolicy], page: Page) -> Iterator[Block]:
    where = f" under the condition {page.report.shown}" if len(page.report.tables.conditions) > 1 else ""
    yield Paragraph(f"The task that each policy inferred from the first observation{where}.")
    yield Terms(TERMS)
    yield Table(router_table(found), "Router accuracy, calibration and latency")
    for one in found:
        yield Heading(one.policy, one.policy)
        yield _confusion(one.policy, one.router.confusion)
        if one.router.calibration is not None:
            yield Charts((_reliability(one.policy, one.router.calibration),))
            yield Paragraph("Accuracy by confidence:")
            yield Table(calibration_table(one.router.calibration), f"{one.policy}: accuracy by confidence")


def _confusion(policy: str, found: Confusion) -> HeatMap:
    rows = []
    for task, counts in zip(found.true, found.counts, strict=True):
        total = sum(counts) or 1
        cells = tuple(_cell(task, *cell, total) for cell in zip(found.inferred, counts, strict=True))
        rows.append((short_task(task), cells))
    columns = tuple(map(short_task, found.inferred))
    title, label = "True task (rows) and inferred task (columns)", f"{policy}: true task and inferred task, episodes"
    return HeatMap(
        label,
        "true task",
        columns,
        tuple(rows),
        title=title,
        table=confusion_table(found),
        figure="confusion",
        about=policy,
        unit="episodes",
    )


def _cell(task: str, inferred: str, episodes: int, total: int) -> HeatCell:
    share, names = episodes / total, f"{short_task(task)} inferred as {short_task(inferred)}"
    title = f"{names}: {counted(episodes, 'episode')}, {percent(share)}"
    text, kind = count(episodes) if episodes else "", "right" if inferred == task else "wrong"
    return HeatCell(share, text, title=title, kind=kind)


def _reliability(policy: str, found: Calibration) -> LineChart:
    made = []
    for one in found.bins:
        if one.accuracy.rate is None:
            continue
        ends = one.accuracy.interval
        low, high = (None, None) if ends is None else (100 * ends.low, 100 * ends.high)
        text = f"confidence {one.confidence:.2f}, accuracy {share(one.accuracy)}, {counted(one.episodes, 'episode')}"
        made.append(Point(100 * one.confidence, 100 * one.accuracy.rate, low, high, text))
    label = f"{policy}: accuracy by the probability of the choice; calibration error {found.expected_error:.3f}"
    ticks = tuple((float(tick), str(tick)) for tick in (0, 25, 50, 75, 100))
    axes, lines = ("probability of the choice (%)", "accuracy (%)"), (Line(policy, tuple(made)),)
    return LineChart(f"{policy}: reliability", label, lines, ticks, *axes, True, "reliability", policy)


SECTIONS = (
    Section(
        name="routing",
        title="Task inference",
        columns=COLUMNS,
        build=build_routing,
        type=tuple[RoutedPolicy, ...],
        blocks=_blocks,
    ),
)
