"""Success: not there at the start, and reached by the task's oracle within the horizon."""

from __future__ import annotations

from collections.abc import Iterator

from orchestrator.conformance.findings import Fault, NotApplicable, check
from orchestrator.conformance.subject import Subject
from orchestrator.rollout import rollout
from policies.oracles import OraclePolicy, scripts
from results.record import Status
from suites.vocabulary import Episode, Protocol

SEEDS = range(2)


@check("start-is-no-success", look="the success predicate in Simulation.step")
def start_is_no_success(subject: Subject) -> Iterator[Fault]:
    """Nothing has succeeded, or ended, at the start."""
    for seed in SEEDS:
        outcome = subject.reset(seed).step(subject.action())
        if outcome.success or outcome.terminated:
            yield Fault(f"no success at the first step of seed {seed}, and no end", str(outcome))


@check("oracle", look="the success predicate, the horizon of the TaskCard, or the task's script (policies/oracles)")
def oracle(subject: Subject) -> Iterator[Fault]:
    """The task's oracle succeeds within the horizon."""
    if subject.task not in scripts():
        raise NotApplicable(
            f"there is no oracle for it; bring one in an entry point '{subject.simulator.name}' of robogauntlet.oracles"
        )
    protocol = Protocol(subject.card.horizon, 1, subject.view)
    for seed in SEEDS:
        played = rollout(subject.simulation, OraclePolicy(), Episode("oracle", "oracle", subject.task, seed, protocol))
        if played.status != Status.SUCCESS:
            once = "held once, not for 5 steps in a row" if played.success_once else "never held"
            yield Fault(
                f"success of the oracle within {subject.card.horizon} steps from seed {seed}",
                f"{played.status} after {played.steps} steps; the predicate {once}",
            )


CHECKS = (start_is_no_success, oracle)
