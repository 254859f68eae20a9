"""The comparison of experts and merged policies as words: tables for the terminal, `report.md` and `report.html`."""

from __future__ import annotations

from collections.abc import Sequence

from results.merging import Losses, Merging, MergingRow, RoutedComparison
from results.report import text
from results.report.text import NOTHING, TextTable
from results.routing import Confusion, Rate
from results.statistics.rates import Estimate

ALL = "all"


def points(estimate: Estimate | None) -> str:
    """A difference of rates in percentage points: `+4.0 [-1.2, 9.0]`; a digit more than rates, to tell it from none."""
    if estimate is None:
        return NOTHING
    value, interval = round(100 * estimate.value, 1) + 0.0, estimate.interval
    ends = [] if interval is None else [f"{round(100 * end, 1) + 0.0:.1f}" for end in (interval.low, interval.high)]
    return f"{value:+.1f} [{', '.join(ends)}]" if ends else f"{value:+.1f}"


def ratio(estimate: Estimate | None) -> str:
    """A ratio of rates in percent: `96 % [91, 100]`."""
    if estimate is None:
        return NOTHING
    rate = text.percent(estimate.value)
    return rate if estimate.interval is None else f"{rate} {text.span(estimate.interval)}"


def share(rate: Rate | None) -> str:
    """A rate with its interval, or why there is none."""
    return NOTHING if rate is None or rate.rate is None else f"{text.percent(rate.rate)} {text.span(rate.interval)}"


def label(row: MergingRow) -> str:
    """What a line is about."""
    return row.task or (f"{row.simulator}, {ALL}" if row.simulator else ALL)


def comparison_table(merging: Merging) -> TextTable:
    """Per task, simulator and all: success of expert, told and each routed policy, with its router's accuracy."""
    header = ["task", f"expert ({merging.expert})", f"told ({merging.told})"]
    for comparison in merging.routed:
        header += [f"routed ({comparison.policy})", "router accuracy"]
    lines = []
    for place, row in enumerate(_lines(merging.routed[0])):
        cells = [label(row), share(row.expert), share(row.told)]
        for comparison in merging.routed:
            routed = _lines(comparison)[place]
            cells += [share(routed.routed), share(accuracy(comparison, routed))]
        lines.append(tuple(cells))
    return TextTable(tuple(header), tuple(lines), 1)


def compact_table(comparison: RoutedComparison) -> TextTable:
    """The same of one routed policy, for a terminal: rates without intervals, and how many episodes each is of."""
    lines = []
    for row in _lines(comparison):
        rates = (row.expert, row.told, row.routed, accuracy(comparison, row))
        judged = sorted({rate.trials for rate in rates if rate is not None and rate.trials})
        shown = (NOTHING if rate is None else text.percent(rate.rate) for rate in rates)
        lines.append((label(row), *shown, "/".join(map(str, judged)) or NOTHING))
    return TextTable(("task", "expert", "told", "routed", "router accuracy", "n"), tuple(lines), 1)


def overall_table(merging: Merging) -> TextTable:
    """What was lost over all tasks, a column per routed policy."""
    names = ("loss by merging", "loss by routing", "both", "retention", "pairs", "left out")
    columns = [_losses(comparison.overall)[1:] for comparison in merging.routed]
    header = ("percentage points", *(comparison.policy for comparison in merging.routed))
    return TextTable(header, tuple((name, *values) for name, *values in zip(names, *columns, strict=True)), 1)


def losses_table(comparison: RoutedComparison) -> TextTable:
    """Per simulator and all, or per task: what was lost by merging, by routing and in total."""
    header = ("", "loss by merging", "loss by routing", "both", "retention", "pairs", "left out")
    return TextTable(header, tuple(_losses(row) for row in _lines(comparison)), 1)


def _losses(row: MergingRow) -> tuple[str, ...]:
    losses = row.losses
    parts = (points(losses.merging), points(losses.routing), points(losses.total), ratio(losses.retention))
    return (label(row), *parts, text.count(losses.pairs), left_out(losses))


def left_out(losses: Losses) -> str:
    """Why pairs are in no loss: `2 errors, 1 missing`."""
    parts = [text.counted(losses.errors, "error") if losses.errors else ""]
    parts.append(f"{losses.missing:,} missing" if losses.missing else "")
    return ", ".join(filter(None, parts)) or "0"


def router_table(merging: Merging) -> TextTable:
    """Each router's accuracy, also where tasks share a scene, with calibration, latency, regret and rejection."""
    found = [comparison for comparison in merging.routed if comparison.router is not None]
    pairs = dict.fromkeys(pair.tasks for c in found if c.router for pair in c.router.scene_pairs)
    simulators = dict.fromkeys(name for c in found if c.router for name, _ in c.router.simulators)
    header = ("", *(comparison.policy for comparison in found))
    lines: list[tuple[str, ...]] = [("accuracy", *(share(c.router.accuracy) for c in found if c.router))]
    lines += [
        (f"accuracy in {name}", *(share(dict(c.router.simulators).get(name)) for c in found if c.router))
        for name in simulators
    ]
    for tasks in pairs:
        names = " and ".join(map(text.short_task, tasks))
        by_pair = [{p.tasks: p for p in c.router.scene_pairs}.get(tasks) for c in found if c.router]
        lines.append((f"accuracy, {names}", *(share(pair.accuracy) if pair else NOTHING for pair in by_pair)))
        taken = (text.count(pair.mistaken) if pair else NOTHING for pair in by_pair)
        lines.append(("of them taken for the other", *taken))
    lines += _qualities(found)
    return TextTable(header, tuple(line for line in lines if set(line[1:]) != {NOTHING}), 1)


def _qualities(found: Sequence[RoutedComparison]) -> list[tuple[str, ...]]:
    routers = [c.router for c in found if c.router]
    calibrations = [router.calibration for router in routers]
    detections = [router.detection for router in routers]
    return [
        ("calibration error", *(NOTHING if c is None else f"{c.expected_error:.3f}" for c in calibrations)),
        ("Brier score", *(NOTHING if c is None else f"{c.brier:.3f}" for c in calibrations)),
        ("latency, median", *(text.seconds(router.latency.median_s) for router in routers)),
        ("latency, 95th percentile", *(text.seconds(router.latency.p95_s) for router in routers)),
        ("misrouted pairs", *(text.count(c.regret.misrouted) for c in found)),
        ("regret on them", *(points(c.regret.lost) for c in found)),
        ("known tasks rejected", *(share(router.rejected) for router in routers)),
        ("unknown tasks rejected", *(share(d.rejected) if d else NOTHING for d in detections)),
        ("unknown tasks, AUROC", *(f"{d.auroc:.3f}" if d else NOTHING for d in detections)),
        ("unknown tasks, FPR at 95 %", *(text.percent(d.false_positives) if d else NOTHING for d in detections)),
    ]


def confusion_table(confusion: Confusion) -> TextTable:
    """Counts: a line per true task, a column per inferred one."""
    header = ("true task, inferred:", *map(text.short_task, confusion.inferred))
    lines = zip(confusion.true, confusion.counts, strict=True)
    return TextTable(header, tuple((text.short_task(task), *map(text.count, counts)) for task, counts in lines), 1)


def calibration_table(comparison: RoutedComparison) -> TextTable | None:
    """Accuracy by confidence, or None if the scores are no probabilities."""
    if comparison.router is None or comparison.router.calibration is None:
        return None
    lines = tuple(
        (f"{b.low:.1f} to {b.high:.1f}", f"{b.confidence:.2f}", share(b.accuracy), text.count(b.episodes))
        for b in comparison.router.calibration.bins
    )
    return TextTable(("confidence", "mean", "accuracy", "episodes"), lines, 1)


def accuracy(comparison: RoutedComparison, row: MergingRow) -> Rate | None:
    """The router's accuracy on what a line is about."""
    router = comparison.router
    if router is None:
        return None
    if row.task is not None:
        return dict(router.tasks).get(row.task)
    return router.accuracy if row.simulator is None else dict(router.simulators).get(row.simulator)


def _lines(comparison: RoutedComparison) -> tuple[MergingRow, ...]:
    return (*comparison.tasks, *comparison.simulators, comparison.overall)
