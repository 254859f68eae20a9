"""The latency of a policy's answers, measured once and then modelled: `run --latency measured`."""

from __future__ import annotations

from robogauntlet.orchestrator.kit.finding import Finding, Level
from robogauntlet.orchestrator.kit.policy.check import Probe, check_policy
from robogauntlet.suites.timing import MEASURED, Timing, TimingMode
from robogauntlet.support.errors import BadInput


def measured_timing(latency: str, probe: Probe) -> tuple[Timing | None, str]:
    """Ask a policy some dozen times, as `check policy` does, and return the timing of its answers after the first.

    Args:
        latency: `measured` or `MODE:measured`.
        probe: The policy and a task.

    Returns:
        The timing, in whole milliseconds, None if answers take none; and a line that says so.

    Raises:
        BadInput: The mode is none, or the policy did not answer twice.
        PolicyError: The policy cannot be loaded, or cannot act in the task.
        AdapterError: The task cannot be opened.
    """
    mode = latency.rpartition(":")[0] or TimingMode.HOLD
    if mode not in [*TimingMode]:
        raise BadInput(f"--latency: expected {', '.join(TimingMode)} before :{MEASURED}, got '{mode}'")
    findings = [found for found in check_policy(probe) if isinstance(found, Finding)]
    times = next((found.numbers for found in findings if found.topic == "latency"), {})
    if "median_ms" not in times:
        why = next((f"; {found.text}" for found in findings if found.level is Level.FAILED), "")
        raise BadInput(f"--latency: expected a policy that answers in {probe.task}, got no answer times{why}")
    median, p95 = round(times["median_ms"]), round(times["p95_ms"])
    said = f"answers of {probe.name} take {times['median_ms']:.1f} ms (95 % of them up to {times['p95_ms']:.1f} ms)"
    if not median:
        return None, f"{said}, as good as none: the simulation waits"
    timing = Timing(TimingMode(mode), median, p95 if p95 > median else None)
    return timing, f"{said}; played as --latency {timing}"
