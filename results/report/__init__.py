"""The report of a run: `report.html`, `report.md`, `summary.json`, `cells.csv` and `episodes.parquet`."""

from robogauntlet.results.report.summary import Report, ReportPaths, Summary
from robogauntlet.results.report.write import write_report

__all__ = ["Report", "ReportPaths", "Summary", "write_report"]
