"""Draws the documentation's pictures and prints the numbers of docs/statistics.md: `python -m scripts.site.pictures`.

Every number comes from `robogauntlet.results.statistics`, on counts that are given below or taken from the screening
of the shipped policies (studies/screening).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from robogauntlet.results.statistics.multiplicity import ALPHA
from robogauntlet.results.statistics.pairs import Pairs, detectable_drop, mcnemar, paired_difference
from robogauntlet.results.statistics.rates import Interval, rate_bounds, wilson_interval
from robogauntlet.results.statistics.sample_size import pairs_for_power, trials_for_half_width
from robogauntlet.results.statistics.sequential import log_evidence
from scripts.site.concepts import CONCEPTS
from scripts.site.drawing import DOCS, Axes, Drawing

COUNTS = ((9, 10), (18, 20), (45, 50), (90, 100), (900, 1000))
UNRELATED, RELATED = Pairs(76, 14, 9, 1), Pairs(83, 7, 2, 8)
"""Both 90 against 85 of 100: independent outcomes, and correlated ones."""
BLURRED = Pairs(86, 3, 0, 1)
"""Experts and merged policy in the screening under blur of severity 2 (studies/screening)."""
SHARE = 0.2
"""Share of pairs that disagree, for the power of the regression check."""
RUNS, PAIRS, EVERY, SEED = 4000, 400, 10, 0
"""Simulated comparisons of equal policies, pairs of each, pairs between two tests, and the generator's seed."""
MARGIN = 0.05
RATES, WIDTHS = (50, 80, 95), (10, 5, 2.5)
"""Success rates, and half of the intervals' widths, in percent."""
PLANNED = ((20, 5), (20, 10), (25, 15), (30, 20))
"""Pairs that disagree and differences, in percent."""
CASES = (
    ("shown to be no worse", Pairs(1860, 30, 34, 76)),
    ("nothing is shown", Pairs(93, 2, 2, 3)),
    ("shown to be worse", Pairs(160, 4, 26, 10)),
)


def percent(interval: Interval | None, digits: int = 0) -> str:
    """Format an interval as the page does: `[60, 98]`."""
    assert interval is not None
    return f"[{100 * interval.low:.{digits}f}, {100 * interval.high:.{digits}f}]".replace("[-0,", "[0,")


def false_alarms() -> tuple[np.ndarray, np.ndarray]:
    """Return the cumulative false-alarm rates of McNemar's test and of the e-value after each test.

    A fifth of the pairs disagree, in either direction with equal probability.
    """
    from scipy.stats import binom

    draws = np.random.default_rng(SEED).random((RUNS, PAIRS))
    first = np.cumsum(draws < SHARE / 2, axis=1)[:, EVERY - 1 :: EVERY]
    second = np.cumsum((draws >= SHARE / 2) & (draws < SHARE), axis=1)[:, EVERY - 1 :: EVERY]
    disagree = first + second
    p_values = np.minimum(1.0, 2 * binom.cdf(np.minimum(first, second), disagree, 0.5))
    decided = log_evidence(first.ravel(), second.ravel()).reshape(first.shape) >= -np.log(ALPHA)
    return tuple(np.logical_or.accumulate(alarms, axis=1).mean(axis=0) for alarms in (p_values <= ALPHA, decided))


def drops() -> list[tuple[int, float]]:
    """Return numbers of pairs, each with the drop that the regression check detects with power 0.8."""
    detectable = []
    for n in (*range(40, 100, 5), *range(100, 1001, 20)):
        odd = round(SHARE * n)
        drop = detectable_drop(Pairs(n - odd, odd // 2, odd - odd // 2, 0), ALPHA)
        assert drop is not None
        detectable.append((n, drop))
    return detectable


def sample_sizes() -> dict[str, str]:
    """Return the lines of the tables of how many episodes an interval and a comparison need."""
    lines = {}
    for rate in RATES:
        needed = [trials_for_half_width(rate / 100, width / 100) for width in WIDTHS]
        lines[f"interval at {rate}"] = f"| {rate} % | " + " | ".join(f"{count:,}" for count in needed) + " |"
    for discordance, points in PLANNED:
        shares = discordance / 100, points / 100
        counts = f"{pairs_for_power(*shares)}"
        lines[f"comparison at {discordance}, {points}"] = f"| {discordance} % | {points} points | {counts} |"
    return lines


def difference(pairs: Pairs) -> tuple[float, Interval]:
    """Return the paired difference of two success rates, and its interval."""
    estimate = paired_difference(pairs)
    assert estimate is not None
    assert estimate.interval is not None
    return estimate.value, estimate.interval


def numbers() -> Mapping[str, str]:
    """Return the numbers of the page by their names."""
    real = BLURRED
    loss, loss_interval = difference(real)
    bounds = rate_bounds(90, 5, 5)
    peeking, evidence = false_alarms()
    assert bounds is not None
    tasks = [1 - (1 - ALPHA) ** count for count in (9, 20)]
    return {
        **{f"{k} of {n}": percent(wilson_interval(k, n)) for k, n in COUNTS},
        "unrelated": percent(difference(UNRELATED)[1]),
        "related": percent(difference(RELATED)[1]),
        "screening, pairs": f"{real.both}, {real.first_only}, {real.second_only}, {real.neither}",
        "screening, loss": f"{100 * loss:.1f} points {percent(loss_interval, 1)}",
        "screening, p": f"{mcnemar(real):.2f}",
        "9 tasks": f"{100 * tasks[0]:.0f} %",
        "20 tasks": f"{100 * tasks[1]:.0f} %",
        "looked at 40 times": f"{100 * peeking[-1]:.0f} %",
        "evidence": f"{100 * evidence[-1]:.1f} %",
        "drop at 100": f"{100 * dict(drops())[100]:.0f} points",
        "drop at 500": f"{100 * dict(drops())[500]:.0f} points",
        "bounds": f"{100 * bounds.low:.0f} % to {100 * bounds.high:.0f} %",
        "bounds with chance": percent(bounds.interval),
        **sample_sizes(),
        **{
            f"case {number}": f"{100 * difference(pairs)[0]:.1f} {percent(difference(pairs)[1], 1)}"
            for number, (_, pairs) in enumerate(CASES, 1)
        },
    }


def add_estimate(sheet: Drawing, axes: Axes, y: float, value: float, interval: Interval, kind: str) -> None:
    """Draw a share and its interval as a dot on a line."""
    sheet.line([(axes(100 * interval.low), y), (axes(100 * interval.high), y)], f"line-{kind}")
    sheet.dot(axes(100 * value), y, f"fill-{kind}", 4.5)


def intervals() -> Drawing:
    """Intervals of one rate for growing numbers of episodes."""
    sheet = Drawing(480, 216)
    axes = Axes(sheet, 112, 440, 50, 100)
    axes.ticks((50, 60, 70, 80, 90, 100), 22, 178)
    sheet.text(276, 212, "success rate that the count allows (%)", "soft small", anchor="middle")
    for number, (k, n) in enumerate(COUNTS):
        interval, y = wilson_interval(k, n), 36 + 32 * number
        assert interval is not None
        sheet.text(100, y + 4, f"{k} of {n:,}", anchor="end")
        add_estimate(sheet, axes, y, k / n, interval, "one")
    return sheet


def paired() -> Drawing:
    """Intervals of one difference, from correlated and from independent outcomes."""
    sheet = Drawing(480, 158)
    axes = Axes(sheet, 150, 450, -10, 20)
    axes.ticks((-10, 0, 10, 20), 14, 118)
    sheet.line([(axes(0), 8), (axes(0), 118)], "dash")
    sheet.text(300, 152, "90 of 100 against 85 of 100: difference (points)", "soft small", anchor="middle")
    for y, name, more, pairs, kind in (
        (42, "unpaired", "23 pairs disagree", UNRELATED, "two"),
        (92, "paired", "9 pairs disagree", RELATED, "one"),
    ):
        sheet.text(138, y - 2, name, anchor="end")
        sheet.text(138, y + 14, more, "soft small", anchor="end")
        add_estimate(sheet, axes, y, *difference(pairs), kind)
    return sheet


def disagreeing() -> Drawing:
    """The pairs of the screening, one square each."""
    real = BLURRED
    sheet = Drawing(480, 176)
    legend = (
        (24, "fill-soft", "both", real.both),
        (112, "fill-one", "experts only", real.first_only),
        (236, "fill-two", "merged only", real.second_only),
        (362, "shade", "neither", real.neither),
    )
    kinds = [kind for _, kind, _, count in legend for _ in range(count)]
    for number, kind in enumerate(kinds):
        sheet.rect(24 + 24 * (number % 18), 12 + 24 * (number // 18), 20, 20, kind, round_=3)
    for x, kind, label, count in legend:
        sheet.rect(x, 148, 12, 12, kind, round_=2)
        sheet.text(x + 18, 158.5, f"{label}: {count}", "small")
    return sheet


def margins() -> Drawing:
    """Three intervals and the non-inferiority margin."""
    sheet = Drawing(480, 206)
    axes = Axes(sheet, 40, 450, -20, 10)
    sheet.rect(axes(-20), 14, axes(-100 * MARGIN) - axes(-20), 152, "shade")
    axes.ticks((-20, -15, -10, -5, 0, 5, 10), 14, 166)
    sheet.line([(axes(0), 8), (axes(0), 166)], "dash")
    sheet.text(axes(-5) - 6, 26, "worse by more than the margin", "soft small", anchor="end")
    sheet.text(245, 200, "new minus old (points), with its 95 % interval", "soft small", anchor="middle")
    for number, (label, pairs) in enumerate(CASES):
        kind, y = ("three", "four", "two")[number], 62 + 44 * number
        add_estimate(sheet, axes, y, *difference(pairs), kind)
        sheet.text(axes(-20) + 8, y + 4 - 17 * (number == 2), label, f"{kind} bold small")
    return sheet


def curves(
    lines: list[tuple[str, list[tuple[float, float]]]],
    *,
    right: float,
    top: float,
    x_ticks: tuple[float, ...],
    y_ticks: tuple[float, ...],
    below: str,
    above: str,
    labels: list[tuple[float, float, str, str]],
) -> Drawing:
    """Draw lines over two axes, each with its class."""
    sheet = Drawing(480, 250)
    x, y = Axes(sheet, 52, 460, 0, right), Axes(sheet, 204, 34, 0, top)
    for tick in y_ticks:
        sheet.line([(52, y(tick)), (460, y(tick))], "rule")
        sheet.text(44, y(tick) + 4, f"{tick:g}", "soft small", anchor="end")
    for tick in x_ticks:
        sheet.text(x(tick), 222, f"{tick:g}", "soft small", anchor="middle")
    sheet.text(256, 244, below, "soft small", anchor="middle")
    sheet.text(16, 16, above, "soft small")
    for kind, points in lines:
        sheet.line([(x(a), y(b)) for a, b in points], kind)
    for a, b, label, kind in labels:
        sheet.text(x(a), y(b), label, f"{kind} bold small")
    return sheet


def many() -> Drawing:
    """The probability of a false alarm by number of tests."""
    alone = [(float(n), 100 * (1 - (1 - ALPHA) ** n)) for n in range(1, 41)]
    together = [(float(n), 100 * (1 - (1 - ALPHA / n) ** n)) for n in range(1, 41)]
    return curves(
        [("line-two", alone), ("line-one", together)],
        right=40,
        top=100,
        x_ticks=(1, 10, 20, 30, 40),
        y_ticks=(0, 25, 50, 75, 100),
        below="tests in one run, nothing has changed",
        above="probability of at least one alarm (%)",
        labels=[(2, 84, "each at 5 %, unadjusted", "two"), (19, 10, "adjusted by Holm's method", "one")],
    )


def peeking() -> Drawing:
    """The probability of a false alarm when a test is repeated as data arrive."""
    plain, evidence = false_alarms()
    looks = np.arange(EVERY, PAIRS + 1, EVERY)
    return curves(
        [
            ("dash", [(0.0, 5.0), (float(PAIRS), 5.0)]),
            ("line-two", list(zip(looks.tolist(), (100 * plain).tolist(), strict=True))),
            ("line-one", list(zip(looks.tolist(), (100 * evidence).tolist(), strict=True))),
        ],
        right=PAIRS,
        top=30,
        x_ticks=(0, 100, 200, 300, 400),
        y_ticks=(0, 10, 20, 30),
        below="pairs so far, tested after every ten; no true difference",
        above="comparisons declared different so far (%)",
        labels=[(150, 15.5, "McNemar's test", "two"), (255, 7, "e-value", "one")],
    )


def power() -> Drawing:
    """The drop that is detected, by number of pairs."""
    return curves(
        [("line-one", [(float(n), 100 * drop) for n, drop in drops()])],
        right=1000,
        top=25,
        x_ticks=(0, 200, 400, 600, 800, 1000),
        y_ticks=(0, 5, 10, 15, 20, 25),
        below="pairs in the run, a fifth of which disagree",
        above="drop detected in four of five runs (points)",
        labels=[(120, 1.2, "smaller drops are mostly missed", "one")],
    )


def bounds() -> Drawing:
    """Bounds of a rate with errors."""
    sheet = Drawing(480, 126)
    axes = Axes(sheet, 20, 460, 80, 100)
    rate = rate_bounds(90, 5, 5)
    assert rate is not None
    axes.ticks((80, 85, 90, 95, 100), 14, 86)
    sheet.text(240, 120, "success rate (%): 90 successes, 5 failures, 5 errors", "soft small", anchor="middle")
    ends = [axes(100 * end) for end in (rate.interval.low, rate.low, rate.high, rate.interval.high)]
    sheet.line([(ends[0], 50), (ends[3], 50)], "line-one")
    sheet.rect(ends[1], 41, ends[2] - ends[1], 18, "pale-one", round_=3)
    sheet.text((ends[1] + ends[2]) / 2, 33, "errors", "one bold small", anchor="middle")
    sheet.text(ends[0], 76, "chance", "soft small")
    sheet.text(ends[3], 76, "chance", "soft small", anchor="end")
    return sheet


STATISTICS: Mapping[str, Callable[[], Drawing]] = {
    "intervals": intervals,
    "paired": paired,
    "disagreeing": disagreeing,
    "margins": margins,
    "many": many,
    "peeking": peeking,
    "power": power,
    "bounds": bounds,
}


def drawings() -> dict[Path, str]:
    """Return every drawing by its file."""
    images = DOCS / "images"
    return {
        images / folder / f"{name}.svg": draw().svg()
        for folder, pictures in (("statistics", STATISTICS), ("concepts", CONCEPTS))
        for name, draw in pictures.items()
    }


if __name__ == "__main__":
    for path, text in drawings().items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    for name, number in numbers().items():
        print(f"{name}: {number}")
