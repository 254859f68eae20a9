"""The answer of `robogauntlet plan --width` and `--detect`: how many seeds a suite needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from robogauntlet.orchestrator.cli.common import out, print_line
from robogauntlet.orchestrator.cli.console_tables import rich_table
from robogauntlet.orchestrator.registry import load_registry
from robogauntlet.orchestrator.runs.adaptive_stopping import key_of
from robogauntlet.orchestrator.runs.plan import Plan
from robogauntlet.results.api import open_run
from robogauntlet.results.run_document import RUN_FILE
from robogauntlet.suites.registry import stored_states
from robogauntlet.support.errors import BadInput

if TYPE_CHECKING:
    from robogauntlet.results.analysis.episodes_needed import SeedsNeeded

LEAST, MOST = 0.01, 99.99
"""Percentage points that can be asked for."""
Width = Annotated[
    float | None,
    typer.Option(
        "--width",
        min=LEAST,
        max=MOST,
        metavar="POINTS",
        help="How many seeds make the 95 % interval of a success rate +-POINTS wide (percentage points): half of the "
        "distance between its ends.",
    ),
]
Detect = Annotated[
    float | None,
    typer.Option(
        "--detect",
        min=LEAST,
        max=MOST,
        metavar="POINTS",
        help="How many seeds show a difference of POINTS (percentage points) between two policies, in four of five "
        "cases.",
    ),
]
Rate = Annotated[
    float | None,
    typer.Option(
        "--rate",
        min=0,
        max=100,
        metavar="PERCENT",
        help="Success rate that --width assumes; by default that of the run in --out, else 50, the worst case.",
    ),
]
Discordance = Annotated[
    float | None,
    typer.Option(
        "--discordance",
        min=LEAST,
        max=100,
        metavar="PERCENT",
        help="Pairs in which the two policies disagree, which --detect assumes; by default those of the run in --out, "
        "else as many as of independent outcomes.",
    ),
]


@dataclass(frozen=True)
class Asked:
    """The options, as shares between 0 and 1."""

    width: float | None
    detect: float | None
    rate: float | None
    discordance: float | None

    @classmethod
    def from_options(
        cls, width: float | None, detect: float | None, rate: float | None, discordance: float | None
    ) -> Asked:
        """Read options in percent. Raises BadInput if one lacks the option that it is for, or contradicts it."""
        if rate is not None and width is None:
            raise BadInput("--rate: expected with --width, whose interval it is for")
        if discordance is not None and detect is None:
            raise BadInput("--discordance: expected with --detect, whose pairs it is about")
        if discordance is not None and detect is not None and discordance < detect:
            raise BadInput(
                f"--discordance {discordance:g}: expected at least the difference to detect, {detect:g}, since "
                "policies differ by the pairs in which they disagree"
            )
        return cls(*(None if value is None else value / 100 for value in (width, detect, rate, discordance)))

    def __bool__(self) -> bool:
        return self.width is not None or self.detect is not None


def answer(plan: Plan, asked: Asked, folder: Path | None, store: str | None) -> list[SeedsNeeded]:
    """Compute the seeds that a suite needs, for each question.

    Args:
        plan: The suite.
        asked: What was asked for.
        folder: A run of the suite, whose episodes say what to assume.
        store: URL of its store, if it is not in the folder.

    Raises:
        BadInput: The suite has no two policies to compare, or the folder has no episodes that say what to assume.
        StoreError: The episodes cannot be read.
    """
    from robogauntlet.results.analysis import episodes_needed as needed

    policies = {cell.policy: cell.policy_digest for cell in plan.cells}
    if asked.detect is not None and len(policies) < 2:
        raise BadInput(
            f"--detect: expected two policies or more to compare, suite '{plan.suite.name}' has "
            f"{', '.join(policies) or 'none'}; add another with --policy"
        )
    size = needed.SuiteSize(
        policies=tuple(policies.items()),
        tasks=plan.suite.tasks,
        seeds=plan.suite.seeds.count,
        cells=tuple(key_of(cell) for cell in plan.cells),
        comparison=plan.suite.comparison,
        most_seeds=_most_seeds(plan),
    )
    stored = needed.NOTHING
    if folder is not None:
        if not (folder / RUN_FILE).exists():
            raise BadInput(
                f"{folder}: expected a run of the suite, whose episodes say what to assume; it has no run.json"
            )
        stored = needed.Stored.from_rows(open_run(folder, store).episodes(needed.COLUMNS))
        _check_stored(size, stored, asked, folder)
    answers: list[SeedsNeeded] = []
    if asked.width is not None:
        answers += needed.seeds_for_width(size, asked.width, rate=asked.rate, stored=stored)
    if asked.detect is not None:
        answers += needed.seeds_for_difference(size, asked.detect, discordance=asked.discordance, stored=stored)
    return answers


def _most_seeds(plan: Plan) -> int | None:
    """Seeds from the suite's first on that start each of its tasks differently; None without a limit."""
    states = stored_states(plan.suite.tasks, load_registry().tasks)
    return min(states) - plan.suite.seeds.start if states and plan.suite.seeds.start < min(states) else None


def _check_stored(size: Any, stored: Any, asked: Asked, folder: Path) -> None:
    """Raise BadInput if a run has nothing that says what to assume."""
    names = [digest for _, digest in size.policies]
    if asked.width is not None and asked.rate is None and not any(map(stored.counts, names)):
        raise BadInput(f"{folder}: expected clean episodes with a verdict, it has none; give --rate")
    pairs = ((names[first], names[second]) for first, second in size.pairs())
    if asked.detect is not None and asked.discordance is None and not any(stored.disagreements(*two) for two in pairs):
        raise BadInput(f"{folder}: expected clean episodes of two policies, it has no pair; give --discordance")


def print_answer(found: Sequence[SeedsNeeded], seeds: int) -> None:
    """Print what `answer` found: a table, and what was assumed."""
    from robogauntlet.results.report.episodes_needed import assumptions, seeds_table

    out.print()
    out.print(rich_table(seeds_table(found, seeds), title="Seeds per task that are needed"))
    out.print()
    for line in assumptions(found, seeds):
        print_line(f"- {line}")
