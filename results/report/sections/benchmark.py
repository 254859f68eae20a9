"""What success in these tasks needs, and which differences they can still show.

A benchmark says little where policies succeed without the instruction or the images, where they fail as soon as objects
lie elsewhere than in its stored states, or where they succeed too often to be told apart (arXiv 2606.04233).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from robogauntlet.results.analysis.robustness import ControlRow, Robustness
from robogauntlet.results.report.blocks import Block, Sentences, Table, Terms
from robogauntlet.results.report.facts import DEFINITIONS
from robogauntlet.results.report.formatting import NOTHING, TextTable, points, rate
from robogauntlet.results.report.section import Page, Report, Section, Source
from robogauntlet.results.statistics.pairs import MARGIN
from robogauntlet.results.statistics.rates import Estimate
from robogauntlet.results.statistics.sample_size import separate_difference, shrunk_share
from robogauntlet.suites.episode import Condition

EPISODES = 500
"""Of each side of a comparison: ten tasks of fifty episodes, as results of LIBERO's suites are published."""
WITHOUT = {
    "blank-instruction": ("without the instruction", "the instruction"),
    "wrong-goal": ("at the task's goal when told another one", "to be told this goal"),
    "blind": ("with black images", "images"),
    "resampled": ("from newly drawn placements", "the stored states"),
}
"""Control to how the episodes are played, and what success needs if they fail."""


@dataclass(frozen=True, slots=True)
class PolicyControls:
    """A policy in one simulator, or in all."""

    policy: str
    simulator: str | None
    clean: Estimate
    controls: tuple[ControlRow, ...]
    difference: float | None
    """Smallest true drop from the clean rate that `EPISODES` separate episodes a side show with 80 % power; None if
    there is none."""
    is_saturated: bool
    """Whether a policy that never fails would not be shown to be better with as many episodes."""


def build_controls(source: Source) -> tuple[PolicyControls, ...] | None:
    """The policies that were played under a control, without no-skill baselines; None if there are none."""
    robustness: Robustness | None = source.data.get("robustness")
    if robustness is None:
        return None
    rows: dict[tuple[str, str | None], list[ControlRow]] = {}
    for row in robustness.controls:
        if row.policy not in robustness.no_skill_baselines and row.control in WITHOUT:
            rows.setdefault((row.policy, row.simulator), []).append(row)
    totals = (*source.tables.by_policy, *source.tables.by_simulator)
    counts = {(one.policy, one.simulator): one.tally for one in totals if one.condition == Condition()}
    found = []
    for (policy, simulator), own in rows.items():
        tally = counts[policy, simulator]
        assumed = shrunk_share(tally.successes, tally.verdicts)
        least = separate_difference(assumed, EPISODES)
        best = separate_difference(1.0, EPISODES)
        found.append(PolicyControls(policy, simulator, own[0].clean, tuple(own), least, 1 - assumed < (best or 1.0)))
    return tuple(found) or None


def control_table(found: Sequence[PolicyControls]) -> TextTable:
    """Clean success, that under each control with what was lost, and the smallest difference that can be shown."""
    names = tuple(dict.fromkeys(row.control for one in found for row in one.controls))
    header = ("policy", "simulator", "clean", "difference shown (points)")
    lines = []
    for one in found:
        rows = {row.control: row for row in one.controls}
        cells = [one.policy, one.simulator or "all", rate(one.clean), _shown(one)]
        for name in names:
            cells += [rate(rows[name].rate), points(rows[name].drop)] if name in rows else [NOTHING, NOTHING]
        lines.append(tuple(cells))
    return TextTable((*header, *(word for name in names for word in (name, "lost"))), tuple(lines), 2)


def sentences(found: Sequence[PolicyControls]) -> Iterator[str]:
    """What each policy's success needs in all its tasks, and whether it can be told from a better one's."""
    several = any(one.simulator is None for one in found)
    for one in found:
        if several and one.simulator is not None:
            continue
        for row in one.controls:
            how, what = WITHOUT[row.control]
            said = f"{one.policy}: success {how} {rate(row.rate)}, clean {rate(row.clean)}"
            yield f"{said}; {_verdict(row.drop, what)}."
        if one.is_saturated:
            yield f"{one.policy}: one that never fails would not be shown to be better in {EPISODES} episodes a side."


def _verdict(drop: Estimate, what: str) -> str:
    if drop.interval is not None and drop.interval.low > 0:
        return f"it needs {what}"
    if drop.interval is not None and drop.interval.high < MARGIN:
        return f"it does not need {what} (loses less than {100 * MARGIN:.0f} points)"
    return f"it is not shown to need {what}, nor to do without"


def _shown(one: PolicyControls) -> str:
    return NOTHING if one.difference is None else f"{100 * one.difference:.1f}"


def _blocks(found: Sequence[PolicyControls], page: Page) -> Iterator[Block]:
    yield Sentences(tuple(sentences(found)))
    yield Terms(
        {
            "control": DEFINITIONS["control"],
            "difference shown": f"The smallest drop from this clean rate that {EPISODES} separate episodes a side show "
            "with 80 % power at 5 %.",
        }
    )
    yield Table(control_table(found), "Success under the controls")


def _text_tables(found: Sequence[PolicyControls], report: Report) -> Iterator[tuple[str, TextTable]]:
    yield "Success under the controls", control_table(found)


SECTIONS = (
    Section(
        name="benchmark",
        title="What success needs here",
        build=build_controls,
        type=tuple[PolicyControls, ...],
        blocks=_blocks,
        sentences=sentences,
        text_tables=_text_tables,
    ),
)
