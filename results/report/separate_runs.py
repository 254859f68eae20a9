"""A comparison of two runs on separate trials in words and as tables."""

from __future__ import annotations

from collections.abc import Iterator

from robogauntlet.results.analysis.separate_runs import RunAgreement, SeparateRuns
from robogauntlet.results.report import unpaired
from robogauntlet.results.report.formatting import NOTHING, TextTable, counted, number, rate


def reasons(comparison: SeparateRuns) -> list[str]:
    """What is compared and what it shows, a line each."""
    lines = [f"{kind}: {words}" for kind, words in comparison.differences.items()]
    names = (comparison.run, comparison.baseline)
    for one in comparison.separate:
        policy = one.first.policy
        lines.append(unpaired.headline(one, policy))
        told = unpaired.sentences(one, names, comparison.alpha, comparison.margin)
        lines += [f"{policy}: {sentence}" for sentence in told]
    if comparison.agreement is not None:
        lines += _predicts(comparison.agreement, names, comparison.alpha)
    return [*lines, *comparison.notes]


def _predicts(found: RunAgreement, names: tuple[str, str], alpha: float) -> Iterator[str]:
    policies, tasks = counted(len(found.policies), "policy", "policies"), counted(len(found.tasks), "task")
    r = NOTHING if found.pearson is None else f"{found.pearson:.2f}"
    yield (
        f"{names[0]} predicts {names[1]}, by {policies} in {tasks}: Pearson's r {r}, Kendall's tau "
        f"{number(found.tau)}, MMRV {number(found.violation)} (a success rate in {names[1]}; 0 is best)"
    )
    if found.pearson is None:
        yield "r and tau are not defined where all policies have the same rate in a run"
    yield (
        f"tau and MMRV are in their intervals with a probability of at least {100 * (1 - alpha):g} %, for these "
        f"{policies} only: others may be ordered otherwise; r has no interval, since that of resampled trials misses "
        "the true r too often"
    )


def method(comparison: SeparateRuns) -> str:
    """How the numbers were computed."""
    return (
        "Policies of the same name on separate trials, which are not paired: Fisher's exact test, two-sided, over all "
        "tasks stratified by them; adjusted by Holm's method over all policies, and over all their tasks; intervals "
        f"of {100 * (1 - comparison.alpha):g} % (Newcombe, of rates Wilson)."
    )


def tables(comparison: SeparateRuns) -> list[tuple[str, list[TextTable]]]:
    """The rates of the policies in both runs, and the tasks of each policy that has several; with titles."""
    names, found = (comparison.run, comparison.baseline), comparison.agreement
    shown = []
    if found is not None:
        rows = tuple((one.policy, rate(one.first), rate(one.second)) for one in found.policies)
        title = f"Success, mean of {counted(len(found.tasks), 'task')}"
        shown.append((title, [TextTable(("policy", *names), rows, 1)]))
    several = [one for one in comparison.separate if len(one.tasks) > 1]
    return shown + [(one.first.policy, [unpaired.table(one, names)]) for one in several]
