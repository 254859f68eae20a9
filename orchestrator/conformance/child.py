"""The process in which checks are played. Reads requests, a line each; writes answers to a pipe of their own."""

from __future__ import annotations

import faulthandler
import json
import os
import signal
import sys
from dataclasses import asdict
from typing import Any

from adapters import catalog
from orchestrator.conformance.declaring import modules_loaded_by
from orchestrator.conformance.registry import CHECKS
from orchestrator.conformance.seeds import trace
from orchestrator.conformance.subject import Subject
from suites.vocabulary import RenderProfile, View


def answer(subject: Subject, request: dict[str, Any]) -> Any:
    """What becomes of a request: the findings of a check, or the trace of a seed."""
    if "check" in request:
        return [asdict(finding) for finding in CHECKS[request["check"]].play(subject)]
    return asdict(trace(subject, request["trace"]))


def main() -> None:
    """Serve until the requests end. Arguments: task, view as JSON, number of the answers' file descriptor."""
    task, shown, number = sys.argv[1:]
    faulthandler.register(signal.SIGUSR1, all_threads=False)
    name, _, short = task.partition("/")
    loaded = modules_loaded_by(name)
    told = json.loads(shown)
    view = View(tuple(told["cameras"]), told["image_size"], RenderProfile(told["render_profile"]))
    subject = Subject(catalog.find(name), short, view, loaded_by_declaring=loaded)
    with os.fdopen(int(number), "w") as answers:
        for line in sys.stdin:
            answers.write(json.dumps(answer(subject, json.loads(line))) + "\n")
            answers.flush()
    subject.close()
    os._exit(0)  # without the interpreter's own end, in which renderers crash


if __name__ == "__main__":
    main()
