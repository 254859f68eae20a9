"""All axes together as words: a few numbers per policy, and whether simulators agree."""

from __future__ import annotations

from results.overall import AgreementRow, Overall, OverallRow
from results.report import text
from results.report.robustness import number, rate, short_title
from results.report.shift import p_value
from results.report.text import NOTHING, TextTable
from results.statistics.multiplicity import ALPHA, holm


def overall_table(overall: Overall) -> TextTable:
    """Mean, middle and worst of all levels, per policy and simulator."""
    header = (
        "policy",
        "simulator",
        "mean",
        "middle half",
        "worst fifth",
        "worst axis",
        "its rate",
        "lowest in",
        "levels",
    )
    return TextTable(header, tuple(_line(row) for row in overall.rows), 2)


def _line(row: OverallRow) -> tuple[str, ...]:
    worst = row.worst
    return (
        row.policy,
        row.simulator or "all",
        *(rate(estimate) for estimate in (row.mean, row.middle, row.tail)),
        short_title(worst.axis),
        rate(worst.rate),
        text.percent(worst.certainty),
        text.count(row.conditions),
    )


def agreement_table(overall: Overall) -> TextTable:
    """Whether simulators order the axes alike by what is lost along them."""
    header = ("policy", "simulators", "Kendall's tau", "p", "MMRV", "axes")
    return TextTable(header, tuple(_agreement(row) for row in overall.agreement), 2)


def _agreement(row: AgreementRow) -> tuple[str, ...]:
    tau = NOTHING if row.tau is None else number(row.tau)
    p = NOTHING if row.p is None else p_value(row.p)
    return (row.policy, f"{row.one}, {row.other}", tau, p, f"{100 * row.violation:.1f}", text.count(row.axes))


def agreement_findings(overall: Overall) -> list[str]:
    """One sentence per policy: which simulators order the axes alike beyond chance, which oppositely."""
    said = []
    for policy in dict.fromkeys(row.policy for row in overall.agreement):
        rows = [row for row in overall.agreement if row.policy == policy]
        tested = holm([1.0 if row.p is None else row.p for row in rows])
        shown = [row for row, p in zip(rows, tested, strict=True) if p <= ALPHA]
        if shown:
            parts = [f"{row.one} and {row.other} (tau {number(row.tau)})" for row in shown]
            said.append(f"{policy}: {', '.join(parts)} agree on which axes hurt.")
        if len(shown) < len(rows):
            pairs = ", ".join(f"{row.one} and {row.other}" for row in rows if row not in shown)
            said.append(f"{policy}: no agreement on which axes hurt was shown between {pairs}.")
    return said
