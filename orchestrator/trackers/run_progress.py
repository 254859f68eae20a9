"""The progress of a run as metrics for an experiment tracker: counts, pace, and the success of each policy."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping

from robogauntlet.orchestrator.trackers.tracked_run import usable
from robogauntlet.results.live_status import LiveSimulator
from robogauntlet.results.record import EpisodeResult, Status
from robogauntlet.results.run_document import RunDocument
from robogauntlet.results.statistics.rates import wilson_interval
from robogauntlet.suites.episode import CLEAN


class RunProgress:
    """Counts the outcomes of each policy under each condition. Policies and conditions are never pooled."""

    def __init__(self, document: RunDocument, outcomes: Mapping[tuple[str, str, str, int], Mapping[int, str]]) -> None:
        """Begin with the stored outcomes: seed to status by (policy digest, task, axis, severity)."""
        self._names = {cell.policy_digest: cell.policy for cell in reversed(document.plan)}
        self._counts: Counter[tuple[str, str, int, str]] = Counter()
        for (digest, _, axis, severity), seeds in outcomes.items():
            for status, count in Counter(seeds.values()).items():
                self._counts[self._names.get(digest, ""), axis, severity, status] += count

    def count(self, results: Iterable[EpisodeResult]) -> None:
        """Count returned rows."""
        names = self._names
        self._counts.update((names.get(r.policy_digest, ""), r.axis, r.severity, str(r.status)) for r in results)

    def metrics(self, simulators: Iterable[LiveSimulator]) -> dict[str, float]:
        """`progress/done`, `progress/success_rate/POLICY` and so on, with `/AXIS/SEVERITY` if perturbed."""
        listed = tuple(simulators)
        found = {
            "progress/done": float(sum(it.done for it in listed)),
            "progress/planned": float(sum(it.planned for it in listed)),
            "progress/errors": float(sum(it.errors for it in listed)),
        }
        for it in listed:
            if it.per_minute is not None:
                found[f"progress/episodes_per_minute/{usable(it.simulator)}"] = it.per_minute
        for policy, axis, severity in dict.fromkeys(key[:3] for key in self._counts):
            successes = self._counts[policy, axis, severity, str(Status.SUCCESS)]
            n = successes + self._counts[policy, axis, severity, str(Status.FAILURE)]
            interval = wilson_interval(successes, n)
            if not policy or interval is None:
                continue
            place = usable("/".join([policy, *([] if axis == CLEAN else [axis, str(severity)])]))
            found[f"progress/success_rate/{place}"] = successes / n
            found[f"progress/success_rate_low/{place}"] = interval.low
            found[f"progress/success_rate_high/{place}"] = interval.high
            found[f"progress/n/{place}"] = float(n)
        return found
