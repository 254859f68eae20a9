"""Runs as a history describes them: frozen values without a database."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from robogauntlet.results.live_status import LiveStatus
from robogauntlet.results.run_document import STORE_FILE, RunDocument, RunError
from robogauntlet.results.statistics.rates import Interval, wilson_interval
from robogauntlet.results.store.database import file_url, without_password

CellKey = tuple[str, str, str, int]
"""Policy digest, task, axis and severity: `record.CELL`."""
GOOD = ("improved", "no evidence")
"""Verdicts of runs that may be baselines of later ones."""


@dataclass(frozen=True)
class Counts:
    """Counts of episodes by outcome."""

    planned: int = 0
    successes: int = 0
    failures: int = 0
    errors: int = 0

    def __add__(self, other: Counts) -> Counts:
        return Counts(
            self.planned + other.planned,
            self.successes + other.successes,
            self.failures + other.failures,
            self.errors + other.errors,
        )

    @property
    def done(self) -> int:
        """Episodes with a row."""
        return self.successes + self.failures + self.errors

    @property
    def verdicts(self) -> int:
        """Episodes that count in the rate: errors do not."""
        return self.successes + self.failures

    @property
    def rate(self) -> float | None:
        """Successes among those that count; None if there are none."""
        return self.successes / self.verdicts if self.verdicts else None

    @property
    def interval(self) -> Interval | None:
        """Wilson interval of the rate, 95 %."""
        return wilson_interval(self.successes, self.verdicts)


@dataclass(frozen=True)
class CellCounts:
    """Counts of one policy on one task under one condition."""

    policy: str
    policy_digest: str
    task: str
    axis: str
    severity: int
    counts: Counts

    @property
    def simulator(self) -> str:
        """The part of the task's name before the slash."""
        return self.task.partition("/")[0]


@dataclass(frozen=True)
class RunEntry:
    """A run of a history."""

    run_id: str
    suite: str
    status: str
    started_at: float
    """Seconds since 1970, UTC."""
    finished_at: float | None
    counts: Counts
    folder: str | None
    """Folder with its report."""
    rows_url: str | None
    """URL of the store that has its rows (password hidden); None: a file in the folder."""
    verdict: str | None = None
    """Of its comparison with `baseline`, see `robogauntlet.results.analysis.comparison.Verdict`."""
    baseline: str | None = None
    """Id of the run that it was compared with."""
    reasons: tuple[str, ...] = ()
    """Of the verdict, a line each."""
    accepted: bool = False
    """Whether a person accepted it as the baseline of later runs."""
    schedule: str | None = None
    live: LiveStatus | None = None
    """While it runs."""
    policies: int = 1
    """Number of policies, by content. The counts of several policies have no rate in common."""
    imported: bool = False
    """Whether its rows are the word of others: it came as an exported file, or as a folder."""

    @classmethod
    def from_document(cls, document: RunDocument, folder: Path) -> RunEntry:
        """Describe a run that is not in a history."""
        return cls(
            run_id=document.run_id,
            suite=document.suite.name,
            status=str(document.status),
            started_at=document.started_at,
            finished_at=document.finished_at,
            counts=Counts(planned=document.planned),
            folder=str(folder.absolute()),
            rows_url=document.store_url,
            policies=len({cell.policy_digest for cell in document.plan}),
            imported=document.origin == "imported",
        )

    @property
    def name(self) -> str:
        """Name for people: that of its folder."""
        return Path(self.folder).name if self.folder else self.run_id[:12]

    @property
    def is_baseline_material(self) -> bool:
        """Whether it may be the baseline of later runs: complete, not imported, and accepted or not found worse."""
        good = self.accepted or self.verdict in (None, *GOOD)
        return self.status == "complete" and not self.imported and good

    @property
    def status_text(self) -> str:
        """The status for people, `complete` or `complete, imported`."""
        return f"{self.status}, imported" if self.imported else self.status


@dataclass(frozen=True)
class PolicyRunResult:
    """The result of one policy in one run."""

    run: RunEntry
    policy: str
    policy_digest: str
    counts: Counts
    """Over the cells asked for."""


def rows_url(entry: RunEntry, history: str) -> str:
    """Return the URL of the store with a run's rows; `history` is the URL of the entry's store, with its password.

    Raises:
        RunError: The rows are in another database, whose URL (with its password) has to be given, or are gone.
    """
    if entry.rows_url is not None:
        if entry.rows_url == without_password(history):
            return history
        raise RunError(f"{entry.name}: its rows are in {entry.rows_url}; give that address with --store")
    if entry.folder is None:
        return history
    if not (Path(entry.folder) / STORE_FILE).exists():
        raise RunError(f"{entry.name}: expected its rows in {entry.folder}/{STORE_FILE}, they are gone")
    return file_url(Path(entry.folder) / STORE_FILE)
