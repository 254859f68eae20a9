"""The notifications about a run."""

from __future__ import annotations

from dataclasses import dataclass

from robogauntlet.results.analysis.comparison import RunComparison, Verdict
from robogauntlet.results.report.comparison import headline, reasons
from robogauntlet.results.run_document import RunDocument, RunStatus

LONGEST_TITLE = 200
LONGEST_LINE = 2_000


@dataclass(frozen=True)
class Message:
    """A notification. Line breaks are removed from all texts, so that none can add an e-mail header."""

    title: str
    lines: tuple[str, ...]
    """Reasons, one sentence each."""
    run: str
    """Name of the run."""
    link: str | None = None
    """Web address or path of the report."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "title", one_line(self.title, LONGEST_TITLE))
        object.__setattr__(self, "lines", tuple(one_line(line, LONGEST_LINE) for line in self.lines))
        object.__setattr__(self, "run", one_line(self.run, LONGEST_TITLE))
        object.__setattr__(self, "link", None if self.link is None else one_line(self.link, LONGEST_LINE))

    @property
    def footer(self) -> tuple[str, ...]:
        """Lines with the name of the run and its report."""
        return (f"run: {self.run}", *([f"report: {self.link}"] if self.link else []))


def one_line(text: str, limit: int) -> str:
    """Return the text without line breaks and unprintable characters, cut to `limit` characters."""
    plain = " ".join("".join(character if character.isprintable() else " " for character in text).split())
    return plain if len(plain) <= limit else plain[: limit - 1] + "…"


def message_for(document: RunDocument, comparison: RunComparison | None, link: str | None) -> Message | None:
    """Return the notification about a run that has ended, or None if none is needed.

    A regression comes before an early stop, which is then one of the lines. Interrupted runs cause no notification.
    For the link see `Message`.
    """
    ended = f"stopped early: {document.reason or 'no reason was recorded'}"
    stopped = document.status is RunStatus.STOPPED
    if comparison is not None and comparison.verdict is Verdict.REGRESSED:
        lines = (*reasons(comparison), *([ended] if stopped else []))
        return Message(headline(comparison), lines, comparison.run, link)
    complete = document.status is RunStatus.COMPLETE
    if comparison is not None and comparison.verdict is Verdict.NOT_COMPARABLE and complete:
        lines = (*reasons(comparison), f"to make this run the baseline: robogauntlet compare {comparison.run} --accept")
        return Message(headline(comparison), lines, comparison.run, link)
    if not stopped:
        return None
    run = comparison.run if comparison is not None else f"{document.suite.name} {document.run_id[:8]}"
    lines = (ended, "the same command with the same folder continues it")
    return Message(f"STOPPED: {run}", lines, run, link)
