"""Looks at tasks without playing them: a process per simulator, since renderers do not share one well."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Any

from adapters import catalog
from adapters.contract import AdapterError
from orchestrator.environments.homes import Homes
from policies.mergevla.routing.keeping import FirstLooks, file_of, load_looks, save_looks
from suites.vocabulary import Condition, RenderProfile, View

SILENCE_S = 240.0
"""Without a new observation for so long, a simulator is given up."""
Listener = Callable[[str, int, int], None]
"""Told a task, and how many of how many of its episodes have been looked at."""


class SightingError(Exception):
    """Tasks that cannot be looked at; one line per problem."""


@dataclass(frozen=True)
class Seen:
    """What was found."""

    looks: dict[str, FirstLooks]
    """Task to its first observations, which cover all seeds."""
    skipped: dict[str, str]
    """Simulator that is not installed here, to the reason."""


def first_looks(tasks: Sequence[str], view: View, seeds: Sequence[int], folder: Path, listener: Listener) -> Seen:
    """The first observation of each seed of each task, under the clean condition.

    What the folder holds already is not looked at again, unless it was another view or does not cover the seeds.

    Args:
        tasks: `simulator/task`.
        view: What to render.
        seeds: Of the episodes.
        folder: Where to keep a file per task.
        listener: See `Listener`.

    Raises:
        SightingError: A task is unknown, none of the simulators is installed, or one fails.
        RoutingError: A file in the folder is something else.
        OSError: The folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    looks, skipped, homes = {}, {}, Homes()
    wanted: dict[str, list[str]] = {}
    for task in tasks:
        path = file_of(folder, task)
        there = load_looks(path) if path.exists() else None
        if there is not None and there.task == task and there.covers(view, seeds):
            looks[task] = there
            listener(task, len(seeds), len(seeds))
        else:
            wanted.setdefault(task.partition("/")[0], []).append(task)
    for name, own in wanted.items():
        try:
            reason = homes.missing_reason(catalog.find(name))
        except AdapterError as error:
            raise SightingError(str(error)) from None
        if reason:
            skipped[name] = reason
            continue
        _look_in_child(homes, name, own, view, seeds, folder, listener)
        looks |= {task: load_looks(file_of(folder, task)) for task in own}
    if not looks:
        raise SightingError("\n".join(f"{name}: {reason}" for name, reason in skipped.items()))
    return Seen({task: looks[task] for task in tasks if task in looks}, skipped)


def _look_in_child(
    homes: Homes, name: str, tasks: Sequence[str], view: View, seeds: Sequence[int], folder: Path, listener: Listener
) -> None:
    order = json.dumps({"tasks": tasks, "view": asdict(view), "seeds": list(seeds), "folder": str(folder.resolve())})
    python, environment = homes.child(catalog.find(name))
    command = [python, "-m", "orchestrator.sighting"]
    problem, silent = None, threading.Event()
    with tempfile.TemporaryFile("w+") as said, tempfile.TemporaryFile("w+") as asked:
        asked.write(order)
        asked.seek(0)
        with subprocess.Popen(
            command, stdin=asked, stdout=subprocess.PIPE, stderr=said, text=True, errors="replace", env=environment
        ) as child:
            try:
                assert child.stdout is not None
                for line in _lines(child, child.stdout, silent):
                    told = json.loads(line)
                    problem = told.get("problem", problem)
                    if "task" in told:
                        listener(told["task"], told["done"], len(seeds))
                code = child.wait()
            finally:
                child.kill()
        said.seek(0)
        last = (said.read().strip().splitlines() or ["no message"])[-1]
    if problem is not None:
        raise SightingError(f"{name}: {problem}")
    if silent.is_set():
        raise SightingError(f"{name}: expected an observation within {SILENCE_S:g} s, none came")
    if code:
        raise SightingError(f"{name}: the process that looked ended with code {code}: {last}")


def _lines(child: subprocess.Popen[str], told: IO[str], silent: threading.Event) -> Iterator[str]:
    """What the child says. If it says nothing for too long it is killed, and `silent` is set."""

    def give_up() -> None:
        silent.set()
        child.kill()

    while True:
        watchdog = threading.Timer(SILENCE_S, give_up)
        watchdog.start()
        try:
            line = told.readline()
        finally:
            watchdog.cancel()
        if not line:
            return
        yield line


def _look(order: dict[str, Any], tell: Callable[[dict[str, Any]], None]) -> None:
    seen = order["view"]
    view = View(tuple(seen["cameras"]), seen["image_size"], RenderProfile(seen["render_profile"]))
    for task in order["tasks"]:
        simulation = catalog.open_simulation(task, view)
        observations = []
        for seed in order["seeds"]:
            simulation.reset(seed, Condition())
            observations.append(simulation.observe())
            tell({"task": task, "done": len(observations)})
        simulation.close()
        save_looks(FirstLooks.of(task, view, order["seeds"], observations), file_of(Path(order["folder"]), task))


def _child() -> None:
    """Look as standard input orders, and tell of it on standard output, to which no simulator writes."""
    told = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)

    def tell(what: dict[str, Any]) -> None:
        print(json.dumps(what), file=told, flush=True)

    try:
        _look(json.load(sys.stdin), tell)
    except Exception as error:  # simulators raise anything
        lines = str(error).strip().splitlines() or ["no message"]
        tell({"problem": lines[0] if isinstance(error, AdapterError) else f"{type(error).__name__}: {lines[0]}"})


if __name__ == "__main__":
    _child()
    os._exit(0)  # some drivers crash when they are torn down
