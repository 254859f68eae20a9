"""How a policy did from run to run: as a table, and as a picture that pages and files can hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from html import escape
from pathlib import Path

from results.entries import Night
from results.leaderboard import Standing
from results.report.text import NOTHING, TextTable, count, percent, span

WIDTH, HEIGHT, LEFT, BOTTOM = 760, 260, 44, 34
MARKS = {"regressed": "▼", "improved": "▲", "not comparable": "≠"}


def when(seconds: float | None) -> str:
    """Seconds since 1970 as `2026-11-22 02:00` (UTC)."""
    return NOTHING if seconds is None else f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M}"


def verdict_text(verdict: str | None, *, accepted: bool = False) -> str:
    """A verdict with its mark."""
    words = NOTHING if verdict is None else f"{MARKS[verdict]} {verdict}" if verdict in MARKS else verdict
    return f"{words}, accepted" if accepted else words


def nights_table(nights: Sequence[Night]) -> TextTable:
    """A line per run."""
    header = ("begun (UTC)", "run", "suite", "content", "verdict", "rate", "interval", "episodes", "errors")
    rows = tuple(
        (
            when(night.run.started_at),
            night.run.name,
            night.run.suite,
            night.policy_digest[:8],
            verdict_text(night.run.verdict, accepted=night.run.accepted),
            percent(night.counts.rate),
            span(night.counts.interval),
            count(night.counts.verdicts),
            count(night.counts.errors),
        )
        for night in nights
    )
    return TextTable(header, rows, 5)


def standings_table(standings: Sequence[Standing]) -> TextTable:
    """A line per policy; those that share a letter were not shown to differ."""
    header = ("policy", "content", "letters", "run", "begun (UTC)", "mean of tasks", "interval", "episodes")
    rows = tuple(
        (
            one.policy,
            one.policy_digest[:8],
            one.letters,
            one.run,
            when(one.started_at),
            percent(one.rate),
            span(one.interval),
            count(one.verdicts),
        )
        for one in standings
    )
    return TextTable(header, rows, 5)


def sparkline(nights: Sequence[Night]) -> str:
    """Rates as a line of blocks, from 0 to 100 %; a run without a verdict is a dot."""
    blocks = "▁▂▃▄▅▆▇█"
    rates = [night.counts.rate for night in nights]
    return "".join("·" if rate is None else blocks[min(int(rate * len(blocks)), len(blocks) - 1)] for rate in rates)


@dataclass(frozen=True)
class _Point:
    night: Night
    x: float
    new: bool
    """The policy's content is another than in the run before."""


def plot(nights: Sequence[Night], title: str, link: str | None = None) -> str:
    """An SVG of success by run with 95 % intervals; where the content changed there is a line.

    Args:
        nights: The oldest first.
        title: What a screen reader says first.
        link: Address of a run's page, with `{run}` for its id; None for no links.
    """
    shown = [night for night in nights if night.counts.rate is not None]
    width, step = WIDTH - LEFT - 12, 1.0
    if len(shown) > 1:
        step = width / (len(shown) - 1)
    points = [
        _Point(night, LEFT + (i * step if len(shown) > 1 else width / 2), _is_new(shown, i))
        for i, night in enumerate(shown)
    ]
    last = f", last {percent(shown[-1].counts.rate)}" if shown else ""
    parts = [
        f'<svg class="nights" xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" '
        f'aria-label="{escape(f"{title}: {len(shown)} runs{last}")}">',
        "<style>.nights text{font:12px system-ui,sans-serif;fill:currentColor}.nights .grid{stroke:currentColor;"
        "stroke-opacity:.15}.nights .bar{stroke:#0072b2;stroke-width:2;stroke-opacity:.45}.nights .dot{fill:#0072b2}"
        ".nights .bad{fill:#d55e00}.nights .good{fill:#009e73}.nights .path{fill:none;stroke:#0072b2;stroke-opacity:.6}"
        ".nights .new{stroke:currentColor;stroke-dasharray:3 3;stroke-opacity:.5}</style>",
    ]
    for level in (0.0, 0.25, 0.5, 0.75, 1.0):
        y = _y(level)
        parts.append(f'<line class="grid" x1="{LEFT}" x2="{WIDTH - 12}" y1="{y:.1f}" y2="{y:.1f}"/>')
        parts.append(f'<text x="{LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{100 * level:.0f} %</text>')
    y1, y2 = _y(1), _y(0)
    parts += [f'<line class="new" x1="{p.x:.1f}" x2="{p.x:.1f}" y1="{y1:.1f}" y2="{y2:.1f}"/>' for p in points if p.new]
    path = " ".join(f"{p.x:.1f},{_y(p.night.counts.rate or 0.0):.1f}" for p in points)
    parts.append(f'<polyline class="path" points="{path}"/>')
    parts += [_dot(point, link) for point in points]
    for point, anchor in ((points[0], "start"), (points[-1], "end")) if len(points) > 1 else ():
        day = when(point.night.run.started_at)
        parts.append(f'<text x="{point.x:.1f}" y="{HEIGHT - 10}" text-anchor="{anchor}">{day}</text>')
    if not points:
        parts.append(f'<text x="{WIDTH / 2}" y="{HEIGHT / 2}" text-anchor="middle">no episode has a verdict yet</text>')
    return "".join([*parts, "</svg>"])


def write_plot(path: Path, nights: Sequence[Night], title: str) -> None:
    """Write the picture: `.svg` as it is, anything else as a page that holds it. Raises OSError."""
    drawn = plot(nights, title)
    if path.suffix != ".svg":
        drawn = (
            '<!doctype html><html lang="en"><meta charset="utf-8"><meta name="color-scheme" content="light dark">'
            '<meta name="viewport" content="width=device-width">'
            f"<title>{escape(title)}</title>"
            "<body style='font:16px system-ui,sans-serif;max-width:900px;margin:32px auto'>"
            f"<h1 style='font-size:20px'>{escape(title)}</h1>{drawn}"
            "<p>Success with 95 % intervals. ▼ worse than the last good run before it; dashed: the policy's content is "
            "another from here on. Hover over a point for its run.</p></body></html>"
        )
    path.write_text(drawn + "\n", encoding="utf-8")


def _is_new(nights: Sequence[Night], i: int) -> bool:
    return i > 0 and nights[i].policy_digest != nights[i - 1].policy_digest


def _y(rate: float) -> float:
    return 12 + (1 - rate) * (HEIGHT - BOTTOM - 12)


def _dot(point: _Point, link: str | None) -> str:
    counts, run = point.night.counts, point.night.run
    kind = {"regressed": "bad", "improved": "good"}.get(run.verdict or "", "dot")
    words = f"{run.name}, {when(run.started_at)}: {percent(counts.rate)} {span(counts.interval)}"
    words += f" of {counts.verdicts:,} episodes" + (f", {run.verdict}" if run.verdict else "")
    y = _y(counts.rate or 0.0)
    bar = ""
    if counts.interval is not None:
        low, high = _y(counts.interval.low), _y(counts.interval.high)
        bar = f'<line class="bar" x1="{point.x:.1f}" x2="{point.x:.1f}" y1="{high:.1f}" y2="{low:.1f}"/>'
    shape = f'<circle class="{kind}" cx="{point.x:.1f}" cy="{y:.1f}" r="4.5"/>'
    if kind == "bad":  # another shape as well as another colour
        shape = f'<path class="bad" d="M{point.x - 6:.1f} {y - 5:.1f}h12l-6 11z"/>'
    drawn = f"<g>{bar}{shape}<title>{escape(words)}</title></g>"
    if link is None:
        return drawn
    return f'<a href="{escape(link.format(run=run.run_id))}" aria-label="{escape(words)}">{drawn}</a>'
