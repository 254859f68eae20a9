"""Resources that an adapter uses and releases: processes, threads, files, memory, time."""

from __future__ import annotations

import ctypes
import gc
import threading
import time
from collections.abc import Callable, Iterator

import psutil

from robogauntlet.orchestrator.kit.adapter.check import Violation, check, expect
from robogauntlet.orchestrator.kit.adapter.checked_task import CheckedTask, describe

CYCLES = 2
"""Times that a task is opened and closed, after one that is not counted because libraries keep things."""
MEASURED_AT = (100, 300, 500)
"""Numbers of resets after which memory is measured; buffers that are kept once exist by the first."""
OBSERVE_EVERY = 50
GROWTH_MB = 16.0
"""Growth of memory that is accepted after the first measurement."""
LIMITS_S = {"open": 120.0, "reset": 10.0, "step": 1.0, "observe": 5.0}
"""Longest times with which a run is practical (s)."""
GRACE_S = 1.0
"""Time in which threads and processes that were asked to end are gone (s)."""


@check("closes", look="Simulation.close: processes, threads, sockets, files and contexts that open started", once=True)
def closes(subject: CheckedTask) -> Iterator[Violation]:
    """Closing ends the processes, threads and files of a task, and may be done twice."""
    own = psutil.Process()
    counts: dict[str, Callable[[], int]] = {
        "child process": lambda: sum(map(_runs, own.children(recursive=True))),
        "Python thread": threading.active_count,
        "thread": own.num_threads,
        "file descriptor": own.num_fds,
    }
    subject.reset()
    _open_and_close(subject)
    before = {name: count() for name, count in counts.items()}
    for _ in range(CYCLES):
        _open_and_close(subject)
    for name, count in counts.items():
        if (left := _settled(count, before[name])) >= CYCLES:
            yield Violation(f"nothing left open after {CYCLES} times open and close", f"{left} more {name}(s)")
            return


def _open_and_close(subject: CheckedTask) -> None:
    """Open the task, use it a little, and close it twice."""
    simulation = subject.open()
    simulation.reset(0)
    simulation.observe()
    simulation.step(subject.action())
    simulation.close()
    simulation.close()
    del simulation
    gc.collect()


def _runs(process: psutil.Process) -> bool:
    """Whether the process still runs, and is not a zombie."""
    try:
        return bool(process.status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False


def _settled(count: Callable[[], int], before: int) -> int:
    """The increase of a count, once it had time to fall."""
    deadline = time.monotonic() + GRACE_S
    while (more := count() - before) >= CYCLES and time.monotonic() < deadline:
        time.sleep(0.05)
    return more


@check(
    "memory", look="Simulation.reset: lists that grow, scenes, textures and renderers that are created again", once=True
)
def memory(subject: CheckedTask) -> Iterator[Violation]:
    """Memory stays flat over 500 resets."""
    simulation, used = subject.simulation, []
    for number in range(MEASURED_AT[-1] + 1):
        if number in MEASURED_AT:
            used.append(_used_mb())
        simulation.reset(number % 50)
        if number % OBSERVE_EVERY == 0:
            simulation.observe()
    first, middle, last = used
    grown = 2 * min(middle - first, last - middle)  # a leak grows in both halves, a buffer that is kept once in one
    expected = f"memory to grow by less than {GROWTH_MB:g} MB in {MEASURED_AT[-1] - MEASURED_AT[0]} resets"
    yield from expect(grown <= GROWTH_MB, expected, f"{grown:.0f} MB")


def _used_mb() -> float:
    """Memory of this process (MB), after free memory went back to the system, as it would hide growth (glibc only)."""
    gc.collect()
    if trim := getattr(ctypes.CDLL(None), "malloc_trim", None):
        trim(ctypes.c_size_t(0))
    return float(psutil.Process().memory_info().rss / 2**20)


@check("pace", look="a profile by `python -m cProfile` or py-spy", once=True)
def pace(subject: CheckedTask) -> Iterator[Violation]:
    """Opening, resetting, stepping and observing are fast enough for a run."""
    simulation = subject.simulation
    seconds = {"open": subject.opening_s or 0.0}
    seconds["reset"] = _fastest(lambda: simulation.reset(0))
    seconds["step"] = _fastest(lambda: simulation.step(subject.action()))
    seconds["observe"] = _fastest(simulation.observe)
    for what, limit in LIMITS_S.items():
        yield from expect(seconds[what] <= limit, f"{what} to take less than {limit:g} s", f"{seconds[what]:.3g} s")


def _fastest(call: Callable[[], object], repeats: int = 3) -> float:
    """Shortest duration of a call (s)."""
    durations = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        durations.append(time.perf_counter() - start)
    return min(durations)


@check("survives", look="Simulation.step and reset, after success and beyond the horizon")
def survives(subject: CheckedTask) -> Iterator[Violation]:
    """An episode may be longer than the horizon, and the next begins as usual."""
    simulation = subject.reset(1)
    start = simulation.state_hash()
    try:
        for _ in range(subject.description.horizon + 5):
            if simulation.step(subject.action()).terminated:
                break
    except Exception as error:  # an adapter may raise anything
        yield Violation(f"steps beyond the horizon of {subject.description.horizon}", describe(error))
    same = subject.reset(1).state_hash() == start
    yield from expect(same, "the same start after a long episode", "another state hash")


CHECKS = (pace, survives, memory, closes)
