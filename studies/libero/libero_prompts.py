"""What vla-evaluation-harness tells a policy in LIBERO-PRO and LIBERO-Plus, by its own classes, and what is told here.

`python -m studies libero --measure libero_prompts` lists the tasks of `LIBEROProBenchmark` and `LIBEROPlusBenchmark` of
vla-eval 0.8.0 in the environments of `robogauntlet env create libero` and `libero-plus`. Nothing is played. LIBERO-Plus
is RLinf's distribution, whose module `liberoplus` gets the name that the harness imports.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import ModuleType

from robogauntlet.adapters.contract import Simulator
from robogauntlet.adapters.libero import SIMULATOR as LIBERO
from robogauntlet.adapters.libero.tasks import PRO_AXES, libero_tasks
from robogauntlet.adapters.libero_plus import SIMULATOR as PLUS
from robogauntlet.adapters.libero_plus.variants import variants
from robogauntlet.orchestrator.environments.environment import adapter_environment
from robogauntlet.orchestrator.environments.installer import create
from robogauntlet.orchestrator.environments.resolver import worker_environment
from studies.shared import table_of
from studies.tables import ROOT

SUITES = ("spatial", "object", "goal", "10")
COLUMNS = {
    "benchmark": "{benchmark}",
    "axis": "{axis}",
    "tasks": "{tasks}",
    "other words than here": "{other}",
    "told there, for example": "{there}",
    "told here": "{here}",
}
Told = tuple[str, str, str]
"""Axis of a task, what is told there, and here."""


def measure() -> list[dict[str, object]]:
    """A row for each axis of both benchmarks."""
    rows = [row for simulator in (LIBERO, PLUS) for row in _listed(simulator)]
    table_of(rows, COLUMNS)
    return rows


def _listed(simulator: Simulator) -> list[dict[str, object]]:
    environment = adapter_environment(simulator, always=True)
    assert environment is not None
    create(environment, print)
    variables = os.environ | worker_environment(simulator)
    variables |= {"PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "src")])}
    command = [str(environment.python), "-m", __name__, simulator.name]
    printed = subprocess.run(command, check=True, env=variables, stdout=subprocess.PIPE, text=True).stdout
    rows: list[dict[str, object]] = json.loads(printed.splitlines()[-1])
    return rows


def pro() -> Iterator[Told]:
    """The tasks of LIBERO-PRO."""
    from vla_eval.benchmarks.libero_pro.benchmark import LIBEROProBenchmark

    from robogauntlet.adapters.libero.libero_import import import_libero

    import_libero()
    ours = {(task.suite, task.name): task.instruction for task in libero_tasks().values()}
    for axis, ending in PRO_AXES.items():
        for suite in SUITES:
            for task in LIBEROProBenchmark(f"libero_{suite}", ending).get_tasks():
                yield axis, task["name"], ours[f"pro-{axis}-{suite}", task["task_obj"].name]


def plus() -> Iterator[Told]:
    """The tasks of LIBERO-Plus."""
    ours = {(one.base.libero_suite, one.name): one for one in variants()}
    with tempfile.TemporaryDirectory() as settings:
        os.environ["LIBERO_CONFIG_PATH"] = settings
        inner = importlib.import_module("liberoplus.liberoplus")
        simulation = ModuleType("liberoplus.liberoplus.envs")  # its own needs ImageMagick, and only a parser is used
        simulation.__path__ = [f"{inner.__path__[0]}/envs"]
        sys.modules[simulation.__name__] = simulation
        for name in ("", ".libero", ".libero.benchmark"):
            sys.modules[f"libero{name}"] = importlib.import_module(f"liberoplus{name.replace('libero', 'liberoplus')}")
        from vla_eval.benchmarks.libero_plus.benchmark import LIBEROPlusBenchmark

        for suite in SUITES:
            for task in LIBEROPlusBenchmark(suite=f"libero_{suite}").get_tasks():
                one = ours[f"libero_{suite}", task["task_obj"].name]
                yield one.axis, task["name"], one.instruction


def rows_of(benchmark: str, told: Iterator[Told]) -> list[dict[str, object]]:
    """A row for each axis."""
    by_axis: dict[str, list[tuple[str, str]]] = {}
    for axis, there, here in told:
        by_axis.setdefault(axis, []).append((there, here))
    return [_row(benchmark, axis, tasks) for axis, tasks in by_axis.items()]


def _row(benchmark: str, axis: str, tasks: list[tuple[str, str]]) -> dict[str, object]:
    other = [(there, here) for there, here in tasks if there.lower() != here.lower()]
    there, here = min(other or tasks, key=lambda one: len(one[0]))
    return {
        "benchmark": benchmark,
        "axis": axis,
        "tasks": len(tasks),
        "other": len(other),
        "there": there,
        "here": here,
    }


BENCHMARKS: Mapping[str, tuple[str, Callable[[], Iterator[Told]]]] = {
    "libero": ("LIBERO-PRO", pro),
    "libero-plus": ("LIBERO-Plus", plus),
}

if __name__ == "__main__":
    title, list_tasks = BENCHMARKS[sys.argv[1]]
    with Path(os.devnull).open("w", encoding="utf-8") as null, contextlib.redirect_stdout(null):
        found = rows_of(title, list_tasks())
    print(json.dumps(found))
