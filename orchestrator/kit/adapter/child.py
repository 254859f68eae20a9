"""The child process that runs checks."""

from __future__ import annotations

import faulthandler
import json
import os
import signal
import sys
from dataclasses import asdict
from functools import partial
from importlib import metadata
from typing import Any

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.kit.adapter import CHECKS
from robogauntlet.orchestrator.kit.adapter.checked_task import CheckedTask
from robogauntlet.orchestrator.kit.adapter.seeds import trace
from robogauntlet.suites.episode import RenderProfile, View
from robogauntlet.support.child_process import serve


def answer(subject: CheckedTask, request: dict[str, Any]) -> Any:
    """Answer a request: with the results of a check, or with the trace of a seed."""
    if "check" in request:
        return [asdict(result) for result in CHECKS[request["check"]].run(subject)]
    return asdict(trace(subject, request["trace"]))


def main() -> None:
    """Answer until the requests end. Arguments: task, view as JSON, and the file descriptor of the answers."""
    task, view_json, _ = sys.argv[1:]
    faulthandler.register(signal.SIGUSR1, all_threads=False)
    name, _, short = task.partition("/")
    before = set(sys.modules)
    for entry in metadata.entry_points(group=catalog.GROUP, name=name):
        entry.load()
    loaded = frozenset(set(sys.modules) - before)
    fields = json.loads(view_json)
    view = View(tuple(fields["cameras"]), fields["image_size"], RenderProfile(fields["render_profile"]))
    subject = CheckedTask(catalog.find(name), short, view, loaded_by_declaring=loaded)
    serve(partial(answer, subject))
    subject.close()
    os._exit(0)  # skips the end of the interpreter, in which renderers crash


if __name__ == "__main__":
    main()
