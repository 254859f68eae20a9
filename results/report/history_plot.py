"""Results of a policy from run to run, and leaderboards, as tables and SVG plots."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from robogauntlet.results.analysis.leaderboard import LeaderboardRow
from robogauntlet.results.record import FailureKind
from robogauntlet.results.report.formatting import NOTHING, TextTable, count, escape_html, percent, span
from robogauntlet.results.store.failure_history import RunKinds
from robogauntlet.results.store.history_records import Counts, PolicyRunResult
from robogauntlet.support.output_file import Output
from robogauntlet.support.text import counted

LONGEST_NAME = 500
"""Characters of a run's name or verdict that a mark of the plot shows."""
PLOT = Output("a plot of a history", re.compile(rb'(<!doctype html>.*)?<svg class="history-plot"', re.DOTALL))
WIDTH, HEIGHT, LEFT, BOTTOM = 760, 260, 44, 34
MARKS = {"regressed": "▼", "improved": "▲", "not comparable": "≠"}


def when(seconds: float | None) -> str:
    """A time (seconds since 1970) as `2026-11-22 02:00` (UTC); `–` if there is none or no calendar has it."""
    if seconds is None:
        return NOTHING
    try:
        return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M}"
    except (OverflowError, OSError, ValueError):
        return NOTHING


def verdict_text(verdict: str | None, *, accepted: bool = False) -> str:
    """A verdict with its symbol."""
    words = NOTHING if verdict is None else f"{MARKS[verdict]} {verdict}" if verdict in MARKS else verdict
    return f"{words}, accepted" if accepted else words


def run_rate(counts: Counts, policies: int) -> str:
    """The rate of a run's episodes, `86 % [82, 89]`; for several policies their number, since a rate would mix them."""
    if policies > 1:
        return f"{policies:,} policies"
    return NOTHING if counts.rate is None else f"{percent(counts.rate)} {span(counts.interval)}"


def policy_history_table(results: Sequence[PolicyRunResult]) -> TextTable:
    """The results of a policy, with a row per run."""
    header = ("started (UTC)", "run", "suite", "content", "verdict", "rate", "interval", "episodes", "errors")
    rows = tuple(
        (
            when(result.run.started_at),
            result.run.name,
            result.run.suite,
            result.policy_digest[:8],
            verdict_text(result.run.verdict, accepted=result.run.accepted),
            percent(result.counts.rate),
            span(result.counts.interval),
            count(result.counts.verdicts),
            count(result.counts.errors),
        )
        for result in results
    )
    return TextTable(header, rows, 5)


def kind_history_table(found: Sequence[RunKinds]) -> TextTable:
    """The kinds of a policy's failures, with a row per run and a column per kind that occurs."""
    kinds = [kind for kind in FailureKind if any(kind in one.kinds for one in found)]
    rows = tuple(
        (
            when(one.result.run.started_at),
            one.result.run.name,
            count(one.result.counts.failures),
            *(count(one.kinds.get(kind)) for kind in kinds),
        )
        for one in found
    )
    return TextTable(("started (UTC)", "run", "failures", *kinds), rows, 2)


def new_kinds(found: Sequence[RunKinds]) -> list[str]:
    """A sentence for each run with kinds that no earlier one had, the newest first."""

    def share(one: RunKinds, kind: FailureKind) -> str:
        return f"{kind}, {one.kinds[kind]:,} of {counted(one.result.counts.failures, 'failure')}"

    return [
        f"first seen in {one.result.run.name}: {'; '.join(share(one, kind) for kind in one.new)}"
        for one in reversed(found)
        if one.new
    ]


def leaderboard_table(leaderboard: Sequence[LeaderboardRow]) -> TextTable:
    """A leaderboard; policies that share a letter do not differ significantly."""
    header = ("policy", "content", "letters", "run", "started (UTC)", "mean of tasks", "interval", "episodes")
    rows = tuple(
        (
            row.policy,
            row.policy_digest[:8],
            row.letters,
            row.run,
            when(row.started_at),
            percent(row.rate),
            span(row.interval),
            count(row.verdicts),
        )
        for row in leaderboard
    )
    return TextTable(header, rows, 5)


def sparkline(results: Sequence[PolicyRunResult]) -> str:
    """Rates as a line of block characters from 0 to 100 %; a dot is a run without a rate."""
    blocks = "▁▂▃▄▅▆▇█"
    rates = [result.counts.rate for result in results]
    return "".join("·" if rate is None else blocks[min(int(rate * len(blocks)), len(blocks) - 1)] for rate in rates)


@dataclass(frozen=True)
class _Point:
    result: PolicyRunResult
    x: float
    new: bool
    """Whether the policy's content differs from that in the previous run."""


def plot(results: Sequence[PolicyRunResult], title: str, link: str | None = None) -> str:
    """Return an SVG of success by run, oldest first; dashed lines mark changes of the policy's content.

    `title` is for screen readers; `link` is the URL of a run's page, with `{run}` for its id.
    """
    shown = [result for result in results if result.counts.rate is not None]
    width = WIDTH - LEFT - 12
    places = [i * (width / (len(shown) - 1)) for i in range(len(shown))] if len(shown) > 1 else [width / 2]
    before = [shown[0].policy_digest, *(result.policy_digest for result in shown)] if shown else []
    points = [
        _Point(result, LEFT + place, result.policy_digest != digest)
        for result, place, digest in zip(shown, places, before, strict=False)
    ]
    last = f", last {percent(shown[-1].counts.rate)}" if shown else ""
    label = f"{title}: {counted(len(shown), 'run')}{last}"
    parts = [
        f'<svg class="history-plot" xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" '
        f'aria-label="{escape_html(label)}">',
        "<style>.history-plot text{font:12px system-ui,sans-serif;fill:currentColor}"
        ".history-plot .grid{stroke:currentColor;stroke-opacity:.15}"
        ".history-plot .bar{stroke:#0072b2;stroke-width:2;stroke-opacity:.45}.history-plot .dot{fill:#0072b2}"
        ".history-plot .bad{fill:#d55e00}.history-plot .good{fill:#009e73}"
        ".history-plot .path{fill:none;stroke:#0072b2;stroke-opacity:.6}"
        ".history-plot .new{stroke:currentColor;stroke-dasharray:3 3;stroke-opacity:.5}</style>",
    ]
    for level in (0.0, 0.25, 0.5, 0.75, 1.0):
        y = _y(level)
        parts.append(f'<line class="grid" x1="{LEFT}" x2="{WIDTH - 12}" y1="{y:.1f}" y2="{y:.1f}"/>')
        parts.append(f'<text x="{LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{100 * level:.0f} %</text>')
    y1, y2 = _y(1), _y(0)
    parts += [f'<line class="new" x1="{p.x:.1f}" x2="{p.x:.1f}" y1="{y1:.1f}" y2="{y2:.1f}"/>' for p in points if p.new]
    path = " ".join(f"{p.x:.1f},{_y(p.result.counts.rate or 0.0):.1f}" for p in points)
    parts.append(f'<polyline class="path" points="{path}"/>')
    parts += [_dot(point, link) for point in points]
    for point, anchor in ((points[0], "start"), (points[-1], "end")) if len(points) > 1 else ():
        day = when(point.result.run.started_at)
        parts.append(f'<text x="{point.x:.1f}" y="{HEIGHT - 10}" text-anchor="{anchor}">{day}</text>')
    if not points:
        parts.append(f'<text x="{WIDTH / 2}" y="{HEIGHT / 2}" text-anchor="middle">no results yet</text>')
    return "".join([*parts, "</svg>"])


def write_plot(path: Path, results: Sequence[PolicyRunResult], title: str) -> None:
    """Write an SVG file, or an HTML page with the plot for any other suffix. Raises BadInput as `Output.write`."""
    drawn = plot(results, title)
    if path.suffix != ".svg":
        drawn = (
            '<!doctype html><html lang="en"><meta charset="utf-8"><meta name="color-scheme" content="light dark">'
            '<meta name="viewport" content="width=device-width">'
            f"<title>{escape_html(title)}</title>"
            "<body style='font:16px system-ui,sans-serif;max-width:900px;margin:32px auto'>"
            f"<h1 style='font-size:20px'>{escape_html(title)}</h1>{drawn}"
            "<p>Success with 95 % intervals. ▼ regressed against the baseline run; dashed lines: the policy's content "
            "changed. Hover over a point to see its run.</p></body></html>"
        )
    PLOT.write(path, drawn + "\n")


def _y(rate: float) -> float:
    return 12 + (1 - rate) * (HEIGHT - BOTTOM - 12)


def _dot(point: _Point, link: str | None) -> str:
    counts, run = point.result.counts, point.result.run
    kind = {"regressed": "bad", "improved": "good"}.get(run.verdict or "", "dot")
    words = f"{run.name[:LONGEST_NAME]}, {when(run.started_at)}: {percent(counts.rate)} {span(counts.interval)}"
    words += f" of {counted(counts.verdicts, 'episode')}" + (f", {run.verdict[:LONGEST_NAME]}" if run.verdict else "")
    y = _y(counts.rate or 0.0)
    bar = ""
    if counts.interval is not None:
        low, high = _y(counts.interval.low), _y(counts.interval.high)
        bar = f'<line class="bar" x1="{point.x:.1f}" x2="{point.x:.1f}" y1="{high:.1f}" y2="{low:.1f}"/>'
    shape = f'<circle class="{kind}" cx="{point.x:.1f}" cy="{y:.1f}" r="4.5"/>'
    if kind == "bad":  # another shape as well as another colour
        shape = f'<path class="bad" d="M{point.x - 6:.1f} {y - 5:.1f}h12l-6 11z"/>'
    drawn = f"<g>{bar}{shape}<title>{escape_html(words)}</title></g>"
    if link is None:
        return drawn
    return f'<a href="{escape_html(link.format(run=run.run_id))}" aria-label="{escape_html(words)}">{drawn}</a>'
