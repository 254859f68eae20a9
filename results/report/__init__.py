"""The report of a run: `report.html`, `report.md`, `summary.json`, `cells.csv` and `episodes.parquet`."""

from results.report.summary import Summary
from results.report.text import TextTable, summary_table
from results.report.writing import ReportPaths, read_findings, read_merging, read_tables, write_report

__all__ = [
    "ReportPaths",
    "Summary",
    "TextTable",
    "read_findings",
    "read_merging",
    "read_tables",
    "summary_table",
    "write_report",
]
