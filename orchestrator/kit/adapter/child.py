"""The child process that runs checks."""

from __future__ import annotations

import faulthandler
import os
import signal
import sys
from dataclasses import asdict, replace
from functools import partial
from importlib import metadata
from typing import Any

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.kit.adapter import CHECKS
from robogauntlet.orchestrator.kit.adapter.checked_task import VIEW, CheckedTask
from robogauntlet.orchestrator.kit.adapter.seeds import trace
from robogauntlet.support.child_process import serve


def answer(subject: CheckedTask, request: dict[str, Any]) -> Any:
    """Answer a request: with the findings of a check, or with the trace of a seed."""
    if "check" in request:
        return [asdict(finding) for finding in CHECKS[request["check"]].run(subject)]
    return asdict(trace(subject, request["trace"]))


def main() -> None:
    """Answer until the requests end. Arguments: task, and the file descriptor of the answers."""
    task, _ = sys.argv[1:]
    faulthandler.register(signal.SIGUSR1, all_threads=False)
    name, _, short = task.partition("/")
    before = set(sys.modules)
    for entry in metadata.entry_points(group=catalog.GROUP, name=name):
        entry.load()
    loaded = frozenset(set(sys.modules) - before)
    simulator = catalog.find(name)
    view = replace(VIEW, cameras=simulator.tasks[short].cameras)
    subject = CheckedTask(simulator, short, view, loaded_by_declaring=loaded)
    serve(partial(answer, subject))
    subject.close()
    os._exit(0)  # skips the end of the interpreter, in which renderers crash


if __name__ == "__main__":
    main()
