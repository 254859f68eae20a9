"""What an adapter takes and gives back: processes, threads, files, memory, time."""

from __future__ import annotations

import ctypes
import gc
import threading
import time
from collections.abc import Callable, Iterator

import psutil

from orchestrator.conformance.findings import Fault, check
from orchestrator.conformance.subject import CLEAN, Subject, describe

CYCLES = 2
"""How often a task is opened and closed while it is counted, after once for what libraries keep."""
LOOKS = (100, 300, 500)
"""Numbers of resets after which memory is looked at: what is kept once is there by the first."""
LOOK_EVERY = 50
GROWTH_MB = 16.0
"""By which memory may grow from then on."""
LIMITS_S = {"open": 120.0, "reset": 10.0, "step": 1.0, "observe": 5.0}
"""Beyond these a run is of no use."""
GRACE_S = 1.0
"""In which threads and processes that were told to end are gone."""


@check("closes", look="Simulation.close: processes, threads, sockets, files and contexts that open started", once=True)
def closes(subject: Subject) -> Iterator[Fault]:
    """Closing ends the processes, threads and files of a task, and may be done twice."""
    own = psutil.Process()
    counts: dict[str, Callable[[], int]] = {
        "child process": lambda: sum(child.status() != psutil.STATUS_ZOMBIE for child in own.children(recursive=True)),
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
            yield Fault(f"nothing left open after {CYCLES} times open and close", f"{left} more {name}(s)")
            return


def _open_and_close(subject: Subject) -> None:
    """Open the task, use it a little, and close it twice."""
    simulation = subject.open()
    simulation.reset(0, CLEAN)
    simulation.observe()
    simulation.step(subject.action())
    simulation.close()
    simulation.close()
    del simulation
    gc.collect()


def _settled(count: Callable[[], int], before: int) -> int:
    """How much more there is than before, once it had time to go."""
    deadline = time.monotonic() + GRACE_S
    while (more := count() - before) >= CYCLES and time.monotonic() < deadline:
        time.sleep(0.05)
    return more


@check("memory", look="Simulation.reset: lists that grow, scenes, textures and renderers that are made anew", once=True)
def memory(subject: Subject) -> Iterator[Fault]:
    """Memory stays flat over 500 resets."""
    simulation, kept = subject.simulation, []
    for number in range(LOOKS[-1] + 1):
        if number in LOOKS:
            kept.append(_kept_mb())
        simulation.reset(number % 50, CLEAN)
        if number % LOOK_EVERY == 0:
            simulation.observe()
    first, middle, last = kept
    grown = 2 * min(middle - first, last - middle)  # what leaks grows in both halves, a buffer held once in one
    if grown > GROWTH_MB:
        yield Fault(f"memory to grow by less than {GROWTH_MB:g} MB in {LOOKS[-1] - LOOKS[0]} resets", f"{grown:.0f} MB")


def _kept_mb() -> float:
    """Memory of this process (MB) once what is free went back to the system: it would hide what grows (glibc only)."""
    gc.collect()
    if trim := getattr(ctypes.CDLL(None), "malloc_trim", None):
        trim(ctypes.c_size_t(0))
    return float(psutil.Process().memory_info().rss / 2**20)


@check("pace", look="what takes long, by `python -m cProfile` or py-spy", once=True)
def pace(subject: Subject) -> Iterator[Fault]:
    """Opening, resetting, stepping and looking take no longer than a run can wait."""
    simulation = subject.simulation
    seconds = {"open": subject.opening_s or 0.0}
    seconds["reset"] = _fastest(lambda: simulation.reset(0, CLEAN))
    seconds["step"] = _fastest(lambda: simulation.step(subject.action()))
    seconds["observe"] = _fastest(simulation.observe)
    for what, limit in LIMITS_S.items():
        if seconds[what] > limit:
            yield Fault(f"{what} to take less than {limit:g} s", f"{seconds[what]:.3g} s")


def _fastest(call: Callable[[], object], repeats: int = 3) -> float:
    """Seconds that a call takes at best: other work on the machine makes it no faster."""
    taken = []
    for _ in range(repeats):
        began = time.perf_counter()
        call()
        taken.append(time.perf_counter() - began)
    return min(taken)


@check("survives", look="Simulation.step and reset: what happens after success, or far beyond the horizon")
def survives(subject: Subject) -> Iterator[Fault]:
    """An episode may be longer than the horizon, and the next begins as ever."""
    simulation = subject.reset(1)
    start = simulation.state_hash()
    try:
        for _ in range(subject.card.horizon + 5):
            if simulation.step(subject.action()).terminated:
                break
    except Exception as error:  # an adapter may raise anything
        yield Fault(f"steps beyond the horizon of {subject.card.horizon}", describe(error))
    if subject.reset(1).state_hash() != start:
        yield Fault("the same start after a long episode", "another state hash")


CHECKS = (pace, survives, memory, closes)
