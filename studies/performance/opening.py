"""Time to open the kept report of 13,960 episodes, in Chromium on a desk and on a phone."""

from __future__ import annotations

from pathlib import Path
from statistics import median
from typing import Any

from studies.percent import few
from studies.performance.chromium import browser, tab
from studies.shared import table_of
from studies.tables import ROOT

PAGE = ROOT / "studies/screening/report/report.html"
WINDOWS = {"desk": (1280, 900), "phone": (390, 844)}
TIMES = 5
DRAWN = """
new Promise((resolve) => requestAnimationFrame(function drawn() {
  const [painted] = performance.getEntriesByName("first-contentful-paint");
  const { loadEventEnd } = performance.getEntriesByType("navigation")[0];
  if (!painted || !loadEventEnd) return setTimeout(drawn, 5);
  resolve([loadEventEnd, painted.startTime, performance.now()]);
}))
"""
"""Times since the page was requested (ms): of the end of its load event, of its first paint, and after both."""


def measure() -> list[dict[str, Any]]:
    """Open the page several times, each time in a new tab."""
    rows = []
    with browser() as port:
        for name, (width, height) in WINDOWS.items():
            seconds = [_open(port, PAGE, width, height, mobile=name == "phone") for _ in range(few(TIMES))]
            loaded, painted, drawn = (median(times) for times in zip(*seconds, strict=True))
            row = {"page": PAGE.name, "size_mb": PAGE.stat().st_size / 1e6, "window": name, "width": width}
            rows.append({**row, "painted_s": painted, "loaded_s": loaded, "drawn_s": drawn})
    columns = {"page": "`{page}`, {size_mb:.1f} MB", "window": "{window}, {width} px"}
    columns |= {"first paint, s": "{painted_s:.2f}", "loaded, s": "{loaded_s:.2f}", "drawn, s": "{drawn_s:.2f}"}
    table_of(rows, columns)
    return rows


def _open(port: int, page: Path, width: int, height: int, *, mobile: bool) -> list[float]:
    """Seconds until it was loaded, first painted and drawn."""
    with tab(port, width, height, mobile=mobile) as opened:
        opened.open(page.as_uri())
        return [milliseconds / 1000 for milliseconds in opened.evaluate(DRAWN)]
