"""`summary.json`: a run's tables for programs. The model below is its documentation and its schema."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from results.merging import Merging
from results.report.findings import findings
from results.robustness import Robustness
from results.run import Provenance, RunDocument, RunStatus
from results.statistics.rates import CONFIDENCE
from results.tables import Aggregate, CellRow, ErrorGroup, NotRun, Tables, Tally
from results.timing import AnswerTiming, PhaseTiming

SUMMARY_FORMAT = 1
ERROR_GROUPS = 50
"""Error messages listed, most frequent first."""


class Summary(BaseModel):
    """What `summary.json` says. Fields are only added while `format` stays the same; rates are shares in [0, 1]."""

    model_config = ConfigDict(frozen=True, extra="forbid", ser_json_inf_nan="strings")

    format: int = SUMMARY_FORMAT
    run_id: str
    suite_name: str
    suite_hash: str
    """Hash of what was evaluated; equal for suites that plan the same episodes."""
    rows_hash: str | None
    """Hash of all rows, timing aside, if the run got so far."""
    status: RunStatus
    reason: str | None
    """Why the run ended early, if it did."""
    started_at: float
    """Seconds since 1970, UTC."""
    finished_at: float | None
    elapsed_s: float
    """Time spent running, over all sessions (s)."""
    confidence: float = CONFIDENCE
    """Of every interval."""
    total: Tally
    episodes_per_hour: float | None
    policies: tuple[Aggregate, ...]
    """Per policy and condition, over all simulators."""
    simulators: tuple[Aggregate, ...]
    """Per policy, simulator and condition."""
    cells: tuple[CellRow, ...]
    """Per policy, task and condition."""
    timing: tuple[PhaseTiming, ...]
    """Worker time per simulator."""
    answers: tuple[AnswerTiming, ...] = ()
    """How long policies took to answer."""
    skipped: dict[str, str]
    """Simulator to the reason why it could not run."""
    not_run: tuple[NotRun, ...]
    """Cells with planned episodes that have no row."""
    errors: tuple[ErrorGroup, ...] = Field(max_length=ERROR_GROUPS)
    error_messages: int
    """Different error messages, of which `errors` lists the most frequent."""
    render_devices: dict[str, str]
    """Simulator to what drew its images."""
    workers: dict[str, int]
    """Simulator to its number of workers in the last session."""
    policy_digests: dict[str, str]
    """Policy to the hash of its content."""
    provenance: Provenance
    merging: Merging | None = None
    """What merging and routing cost, if the suite asks for it."""
    robustness: Robustness | None = None
    """How success falls with severity, if anything was perturbed. Numbers beyond every level are "Infinity"."""
    findings: tuple[str, ...] = ()
    """What the tests of `robustness` show, in sentences."""


def build_summary(
    document: RunDocument, tables: Tables, merging: Merging | None = None, robustness: Robustness | None = None
) -> Summary:
    """The summary of a run."""
    return Summary(
        run_id=document.run_id,
        suite_name=document.suite_name,
        suite_hash=document.suite_hash,
        rows_hash=document.rows_hash,
        status=document.status,
        reason=document.reason,
        started_at=document.started_at,
        finished_at=document.finished_at,
        elapsed_s=document.elapsed_s,
        total=tables.total,
        episodes_per_hour=tables.episodes_per_hour,
        policies=tables.by_policy,
        simulators=tables.by_simulator,
        cells=tables.cells,
        timing=tables.timing,
        answers=tables.answers,
        skipped=dict(tables.skipped),
        not_run=tables.not_run,
        errors=tables.errors[:ERROR_GROUPS],
        error_messages=len(tables.errors),
        render_devices=document.render_devices,
        workers=document.workers,
        policy_digests={cell.policy: cell.policy_digest for cell in tables.cells},
        provenance=document.provenance,
        merging=merging,
        robustness=robustness,
        findings=findings(robustness) if robustness else (),
    )
