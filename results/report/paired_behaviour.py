"""How two sides move and fail on the same episodes, as sentences and tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

from robogauntlet.results.analysis.failures import KINDS, OUTCOMES
from robogauntlet.results.analysis.paired_behaviour import LEAST_PAIRS, BehaviourComparison, MeasureLine, OutcomeChange
from robogauntlet.results.report.formatting import TextTable, count, counted, p_value

NAMES = {
    "path_length": ("path length", "m"),
    "time_to_success": ("time to success", "s"),
    "smoothness": ("smoothness", ""),
    "gripper_openings": ("gripper openings", ""),
    "contact_steps": ("contact", "steps"),
    "contact_force": ("largest contact force", "N"),
}
"""Name and unit of each measure."""


def sentences(found: BehaviourComparison, first: str, second: str, alpha: float) -> Iterator[str]:
    """What is shown about how two sides move, and how each fails."""
    both = f"Both succeed in {counted(found.pairs, 'pair')}"
    shown = [line for line in found.measures if line.adjusted <= alpha]
    if shown:
        listed = ", ".join(f"{NAMES[line.measure][0]} {difference(line)}" for line in shown)
        yield f"{both}; differences shown there, medians of {first} minus {second}: {listed}."
    elif found.measures:
        yield f"{both}; no difference in how they move there is shown."
    else:
        yield f"{both}, too few to compare how they move: {LEAST_PAIRS} start states are needed."
    for name, kinds in ((first, kinds_of(found.changes, 0)), (second, kinds_of(found.changes, 1))):
        if kinds:
            yield f"Failures of {name}: {', '.join(f'{kinds[kind]:,} {kind}' for kind in KINDS if kind in kinds)}."


def kinds_of(changes: Sequence[OutcomeChange], side: int) -> Counter[str]:
    """Number of failures of each kind of the first (0) or second (1) side."""
    counts: Counter[str] = Counter()
    for change in changes:
        outcome = (change.first, change.second)[side]
        if outcome in KINDS:
            counts[outcome] += change.pairs
    return counts


def difference(line: MeasureLine) -> str:
    """A median difference with interval and unit: `+0.031 m [0.012, 0.05]`."""
    value, ends, unit = line.difference.value, line.difference.interval, NAMES[line.measure][1]
    shown = f"{value + 0.0:+.3g}" if value else "0"
    return f"{shown} {unit}".rstrip() + (f" [{ends.low + 0.0:.3g}, {ends.high + 0.0:.3g}]" if ends else "")


def tables(found: BehaviourComparison | None, first: str, second: str) -> list[TextTable]:
    """How two sides move and fail; none where that was not measured."""
    moves = [measure_table(found)] if found and found.measures else []
    return moves + ([change_table(found.changes, first, second)] if found and found.changes else [])


def measure_table(found: BehaviourComparison) -> TextTable:
    """The measures in the pairs in which both succeeded."""
    rows = tuple(
        (NAMES[line.measure][0], count(line.pairs), difference(line), p_value(line.p), p_value(line.adjusted))
        for line in found.measures
    )
    return TextTable(("both succeed", "start states", "median difference", "p", "adjusted p"), rows, 1)


def change_table(changes: Sequence[OutcomeChange], first: str, second: str) -> TextTable:
    """Numbers of pairs by the outcome of the first side (rows) and of the second (columns)."""
    counts = {(change.first, change.second): change.pairs for change in changes}
    rows, columns = ([name for name in OUTCOMES if any(both[i] == name for both in counts)] for i in (0, 1))
    lines = tuple((row, *(count(counts.get((row, column))) for column in columns)) for row in rows)
    return TextTable((f"rows {first}, columns {second}", *columns), lines, 1)
