"""Tables that compare experts and merged policies, for the terminal, `report.md` and `report.html`."""

from __future__ import annotations

from robogauntlet.results.analysis.merging_cost import Losses, Merging, MergingRow, RoutedComparison
from robogauntlet.results.analysis.routing import Confusion, Rate
from robogauntlet.results.report import formatting
from robogauntlet.results.report.formatting import NOTHING, TextTable, points, rate, share

ALL = "all"


def label(row: MergingRow) -> str:
    """The task, simulator or `all` of a row."""
    return row.task or (f"{row.simulator}, {ALL}" if row.simulator else ALL)


def comparison_table(merging: Merging) -> TextTable:
    """Success of expert, oracle-routed and each routed policy, and router accuracy, by task and simulator."""
    header = ["task", f"expert ({merging.expert})", f"oracle-routed ({merging.oracle_routed})"]
    for comparison in merging.routed:
        header += [f"routed ({comparison.policy})", "router accuracy"]
    lines = []
    for place, row in enumerate(_lines(merging.routed[0])):
        cells = [label(row), share(row.expert), share(row.oracle_routed)]
        for comparison in merging.routed:
            routed = _lines(comparison)[place]
            cells += [share(routed.routed), share(accuracy(comparison, routed))]
        lines.append(tuple(cells))
    return TextTable(tuple(header), tuple(lines), 1)


def compact_table(comparison: RoutedComparison) -> TextTable:
    """The same of one routed policy for a terminal: rates without intervals, and numbers of episodes."""
    lines = []
    for row in _lines(comparison):
        rates = (row.expert, row.oracle_routed, row.routed, accuracy(comparison, row))
        trials = sorted({found.trials for found in rates if found is not None and found.trials})
        shown = (NOTHING if found is None else formatting.percent(found.rate) for found in rates)
        lines.append((label(row), *shown, "/".join(map(str, trials)) or NOTHING))
    return TextTable(("task", "expert", "oracle-routed", "routed", "accuracy", "n"), tuple(lines), 1)


def overall_table(merging: Merging) -> TextTable:
    """Success lost over all tasks, with a column per routed policy."""
    names = ("loss by merging", "loss by routing", "both", "retention", "pairs", "left out")
    columns = [_losses(comparison.overall)[1:] for comparison in merging.routed]
    header = ("percentage points", *(comparison.policy for comparison in merging.routed))
    return TextTable(header, tuple((name, *values) for name, *values in zip(names, *columns, strict=True)), 1)


def losses_table(comparison: RoutedComparison) -> TextTable:
    """Success lost by merging, by routing and in total, by task and simulator."""
    header = ("", "loss by merging", "loss by routing", "both", "retention", "pairs", "left out")
    return TextTable(header, tuple(_losses(row) for row in _lines(comparison)), 1)


def _losses(row: MergingRow) -> tuple[str, ...]:
    losses = row.losses
    parts = (points(losses.merging), points(losses.routing), points(losses.total), rate(losses.retention))
    return (label(row), *parts, formatting.count(losses.pairs), left_out(losses))


def left_out(losses: Losses) -> str:
    """Number of pairs left out by reason: `2 errors, 1 missing`."""
    parts = [formatting.counted(losses.errors, "error") if losses.errors else ""]
    parts.append(f"{losses.missing:,} missing" if losses.missing else "")
    return ", ".join(filter(None, parts)) or "0"


def router_table(merging: Merging) -> TextTable:
    """Accuracy of each router, also on tasks that share a scene, with calibration, latency, regret and rejection."""
    found = [(c.policy, c.router, c.regret) for c in merging.routed if c.router is not None]
    routers = [router for _, router, _ in found]
    calibrations = [router.calibration for router in routers]
    detections = [router.detection for router in routers]
    lines: list[tuple[str, ...]] = [("accuracy", *(share(router.accuracy) for router in routers))]
    lines += [
        (f"accuracy in {name}", *(share(dict(router.simulators).get(name)) for router in routers))
        for name in dict.fromkeys(name for router in routers for name, _ in router.simulators)
    ]
    for tasks in dict.fromkeys(pair.tasks for router in routers for pair in router.scene_pairs):
        names = " and ".join(map(formatting.short_task, tasks))
        by_pair = [{pair.tasks: pair for pair in router.scene_pairs}.get(tasks) for router in routers]
        lines.append((f"accuracy, {names}", *(share(pair.accuracy) if pair else NOTHING for pair in by_pair)))
        taken = (formatting.count(pair.mistaken) if pair else NOTHING for pair in by_pair)
        lines.append(("confused with each other", *taken))
    lines += [
        ("calibration error", *(NOTHING if c is None else f"{c.expected_error:.3f}" for c in calibrations)),
        ("Brier score", *(NOTHING if c is None else f"{c.brier:.3f}" for c in calibrations)),
        ("latency, median", *(formatting.seconds(router.latency.median_s) for router in routers)),
        ("latency, 95th percentile", *(formatting.seconds(router.latency.p95_s) for router in routers)),
        ("misrouted pairs", *(formatting.count(regret.misrouted) for _, _, regret in found)),
        ("regret on them", *(points(regret.lost) for _, _, regret in found)),
        ("known tasks rejected", *(share(router.rejected) for router in routers)),
        ("unknown tasks rejected", *(share(d.rejected) if d else NOTHING for d in detections)),
        ("unknown tasks, AUROC", *(f"{d.auroc:.3f}" if d else NOTHING for d in detections)),
        ("unknown tasks, FPR at 95 %", *(formatting.percent(d.false_positives) if d else NOTHING for d in detections)),
    ]
    shown = tuple(line for line in lines if set(line[1:]) != {NOTHING})
    return TextTable(("", *(policy for policy, _, _ in found)), shown, 1)


def confusion_table(confusion: Confusion) -> TextTable:
    """Numbers of episodes by true task (rows) and inferred task (columns)."""
    header = ("true task, inferred:", *map(formatting.short_task, confusion.inferred))
    lines = zip(confusion.true, confusion.counts, strict=True)
    return TextTable(
        header, tuple((formatting.short_task(task), *map(formatting.count, counts)) for task, counts in lines), 1
    )


def calibration_table(comparison: RoutedComparison) -> TextTable | None:
    """Accuracy by confidence; None if the scores are not probabilities."""
    if comparison.router is None or comparison.router.calibration is None:
        return None
    lines = tuple(
        (f"{b.low:.2f} to {b.high:.2f}", f"{b.confidence:.2f}", share(b.accuracy), formatting.count(b.episodes))
        for b in comparison.router.calibration.bins
    )
    return TextTable(("confidence", "mean", "accuracy", "episodes"), lines, 1)


def accuracy(comparison: RoutedComparison, row: MergingRow) -> Rate | None:
    """The router accuracy on the tasks of a row."""
    router = comparison.router
    if router is None:
        return None
    if row.task is not None:
        return dict(router.tasks).get(row.task)
    return router.accuracy if row.simulator is None else dict(router.simulators).get(row.simulator)


def _lines(comparison: RoutedComparison) -> tuple[MergingRow, ...]:
    return (*comparison.tasks, *comparison.simulators, comparison.overall)
