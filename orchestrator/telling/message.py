"""What people are told about a run, and when there is something to tell."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass
from enum import StrEnum

from results.comparison import Comparison, Verdict
from results.report.comparison import headline, reasons
from results.run import RunDocument, RunStatus

LONGEST_TITLE = 200
LONGEST_LINE = 2_000
_UNPRINTABLE = {"Cc", "Cf", "Cs", "Zl", "Zp"}
"""Unicode categories that break or turn a line: control and format characters, half characters, separators of lines."""
_TOO_MANY_ERRORS = re.compile(r"\d+ episodes ended in errors, the suite tolerates ")
"""How the reason begins that `scheduler.TooManyErrors` leaves in a run's document."""


class Kind(StrEnum):
    """Why people are told."""

    REGRESSED = "regressed"
    """A policy succeeds less often than in the baseline."""
    ERRORS = "errors"
    """A run ended early: more episodes ended in errors than its suite tolerates."""
    UNJUDGED = "not comparable"
    """A run could not be held against its baseline: nobody watches over it any more."""
    MISSED = "missed"
    """A scheduled run did not begin."""
    STOPPED = "stopped"
    """A run ended early for another reason."""
    TEST = "test"
    """Somebody wants to see whether messages arrive."""


@dataclass(frozen=True)
class Message:
    """What is told. Every text is made one line when the message is made, so that none can become a header or two."""

    kind: Kind
    title: str
    lines: tuple[str, ...]
    """Why, a sentence each."""
    run: str
    """Name of the run."""
    link: str | None = None
    """Where its report is: a web address or a path."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "title", one_line(self.title, LONGEST_TITLE))
        object.__setattr__(self, "lines", tuple(one_line(line, LONGEST_LINE) for line in self.lines))
        object.__setattr__(self, "run", one_line(self.run, LONGEST_TITLE))
        object.__setattr__(self, "link", None if self.link is None else one_line(self.link, LONGEST_LINE))

    @property
    def footer(self) -> tuple[str, ...]:
        """Of which run, and where its report is."""
        return (f"run: {self.run}", *([f"report: {self.link}"] if self.link else []))


def one_line(text: str, limit: int) -> str:
    """The text without line breaks and unprintable characters, cut to `limit` characters."""
    plain = "".join(" " if unicodedata.category(sign) in _UNPRINTABLE else sign for sign in text)
    plain = " ".join(plain.split())
    return plain if len(plain) <= limit else plain[: limit - 1] + "…"


def message_for(document: RunDocument, comparison: Comparison | None, link: str | None) -> Message | None:
    """What people should be told of a run that has ended, or None if it ended as it should.

    A regression is told before an early end, which then is one of its lines. A run that somebody interrupted is not
    told: who did it knows.

    Args:
        document: Of the run.
        comparison: With its baseline, if it was held against one.
        link: Where its report is: a web address or a path.
    """
    ended = f"stopped early: {document.reason or 'no reason is known'}"
    stopped = document.status is RunStatus.STOPPED
    if comparison is not None and comparison.verdict is Verdict.REGRESSED:
        lines = (*reasons(comparison), *([ended] if stopped else []))
        return Message(Kind.REGRESSED, headline(comparison), lines, comparison.run, link)
    complete = document.status is RunStatus.COMPLETE
    if comparison is not None and comparison.verdict is Verdict.NOT_COMPARABLE and complete:
        told = (*reasons(comparison), f"to hold later runs against this one: gauntlet accept {comparison.run}")
        return Message(Kind.UNJUDGED, headline(comparison), told, comparison.run, link)
    if not stopped:
        return None
    run = comparison.run if comparison is not None else f"{document.suite_name} {document.run_id[:8]}"
    lines = (ended, "the same command with the same folder continues it")
    if _TOO_MANY_ERRORS.match(document.reason or ""):
        return Message(Kind.ERRORS, f"TOO MANY ERRORS: {run}", lines, run, link)
    return Message(Kind.STOPPED, f"STOPPED: {run}", lines, run, link)
