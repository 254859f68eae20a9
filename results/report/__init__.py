"""Reports of a run, complete or not: tables and a page, for people and for programs."""

from robogauntlet.results.report.section import Report, ReportPaths
from robogauntlet.results.report.summary import summary_model
from robogauntlet.results.report.write import write_report

__all__ = ["Report", "ReportPaths", "summary_model", "write_report"]
