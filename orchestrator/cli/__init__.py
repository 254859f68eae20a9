"""The command `robogauntlet`. It imports little, so that an interruption finds its handler."""

from __future__ import annotations

import sys
from importlib import import_module
from typing import Any

from robogauntlet.support.interrupts import EXIT_INTERRUPTED, raised_interrupts


def main() -> None:
    """Run the command line.

    Exit codes: 0 success, 1 a difference or regression was found, 2 bad input, 3 stopped early, 130 interrupted.
    """
    with raised_interrupts():
        try:
            from robogauntlet.orchestrator.cli.verbs import run_command

            run_command()
        except KeyboardInterrupt:
            sys.exit(EXIT_INTERRUPTED)


def __getattr__(name: str) -> Any:
    if name in ("VERBS", "app"):
        return getattr(import_module(f"{__name__}.verbs"), name)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
