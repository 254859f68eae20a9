"""The run at a glance: rates, the comparison, why episodes fail, warnings, and what is not shown."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from robogauntlet.results.analysis.failures import OTHER, KindCount, PolicyFailures
from robogauntlet.results.record import FailureKind, Status
from robogauntlet.results.report import pairwise as compared
from robogauntlet.results.report.blocks import Block, Heading, RateGroup, RatePlot, Sentences, Videos
from robogauntlet.results.report.facts import PHRASES
from robogauntlet.results.report.formatting import TextTable, count, counted, share, short_task
from robogauntlet.results.report.media import Video
from robogauntlet.results.report.section import Page, Report, Section
from robogauntlet.results.run_document import RunStatus

FEW = 20
"""Episodes of a policy below which its rate says little: the interval of 10 of 20 is 40 points wide."""
MOST_COMPARISONS = 3
MOST_FINDINGS = 3
MOST_REASONS = 2


def _blocks(_: None, page: Page) -> Iterator[Block]:
    report = page.report
    totals = [total for total in report.tables.by_policy if total.condition == report.shown]
    where = f", {report.shown}" if len(report.tables.conditions) > 1 else ""
    if totals:
        rows = tuple((total.policy, total.tally) for total in totals)
        lines = tuple((name, share(tally), count(tally.verdicts)) for name, tally in rows)
        table = TextTable(("policy", "success", "episodes"), lines, 1)
        yield RatePlot(f"Success in all simulators{where}", (RateGroup("", rows),), table)
    if sentences := [*_comparisons(report), *report.data.get("findings", ())[:MOST_FINDINGS]]:
        yield Sentences(tuple(sentences))
    if reasons := _reasons(report):
        yield Heading("Why episodes fail" + (", under all conditions" if where else ""))
        yield Sentences(tuple(_reason(*reason) for reason in reasons))
        videos = [video for reason in reasons if (video := _video(page, *reason)) is not None]
        if videos:
            yield Videos(tuple((video, _caption(video)) for video in videos))
    if warnings := [*_warnings(report)]:
        yield Heading("To be careful about")
        yield Sentences(tuple(warnings))
    if open_questions := [*_not_shown(report)]:
        yield Heading("Not shown")
        yield Sentences(tuple(open_questions))


def _comparisons(report: Report) -> Iterator[str]:
    found = report.data.get("pairwise")
    if found is None:
        return
    every = (*found.comparisons, *found.unpaired)
    for one in every[:MOST_COMPARISONS]:
        yield f"{compared.headline(one)}."
    if (more := len(every) - MOST_COMPARISONS) > 0:
        yield f"{counted(more, 'more comparison')} below."


def _reasons(report: Report) -> list[tuple[PolicyFailures, KindCount]]:
    """The most frequent kinds of failures, each of a policy in a simulator."""
    found = report.data.get("failures")
    policies: Sequence[PolicyFailures] = () if found is None else found.policies
    reasons = [(one, kind) for one in policies for kind in one.total.kinds if kind.kind != OTHER]
    return sorted(reasons, key=lambda reason: -reason[1].failures)[:MOST_REASONS]


def _reason(one: PolicyFailures, kind: KindCount) -> str:
    number = f"{kind.failures:,} of {counted(one.total.failures, 'failure')}"
    return f"{one.policy} in {one.simulator}: in {number} the robot {PHRASES[FailureKind(kind.kind)]} ({kind.kind})."


def _video(page: Page, one: PolicyFailures, kind: KindCount) -> Video | None:
    for video in (*page.media.representative, *page.media.new_failures):
        is_of = (video.policy, video.simulator, video.failure) == (one.policy, one.simulator, kind.kind)
        if is_of and video.status == Status.FAILURE and video.source is not None:
            return video
    return None


def _caption(video: Video) -> str:
    return f"{video.policy}, {short_task(video.task)}, seed {video.seed}, {video.condition}: {video.outcome}"


def _warnings(report: Report) -> Iterator[str]:
    document, tables = report.document, report.tables
    yield from (f"{warning}." for warning in document.warnings)
    if document.status is not RunStatus.COMPLETE:
        yield f"The run is not complete ({document.status}): {tables.total.missing:,} episodes are missing."
    elif tables.total.missing:
        yield f"{counted(tables.total.missing, 'planned episode')} have no result; see Missing episodes."
    if tables.total.errors:
        yield f"Not played and not counted: {counted(tables.total.errors, 'error')}; see Errors."
    few = [
        f"{total.policy} ({total.tally.verdicts})"
        for total in tables.by_policy
        if total.condition == report.shown and total.tally.verdicts < FEW
    ]
    if few:
        yield f"With fewer than {FEW} episodes a rate says little: {', '.join(few)}."


def _not_shown(report: Report) -> Iterator[str]:
    found = report.data.get("pairwise")
    if found is not None:
        every = (*found.comparisons, *found.unpaired)
        alike = [compared.title(one) for one in every if one.overall.adjusted > found.alpha]
        if alike:
            yield f"No difference is shown: {'; '.join(alike)}. That is not evidence of none."
    if report.data.get("robustness") is None and len(report.tables.conditions) < 2:
        yield "Only clean episodes were played: nothing is said about robustness."


SECTIONS = (Section("short", "In short", _blocks),)
