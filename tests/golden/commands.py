"""What is asked of each kept run on the command line, in this process."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from unittest import mock

from tests.golden.normal import plain

RUN, EARLIER = "runs/kept", "runs/earlier"
LONGEST = 5_000
"""Characters of an output that are recorded."""


def commands(suite: Path, name: str, policies: Sequence[str]) -> list[str]:
    """Command lines, without `robogauntlet`; lists and exports last. `policies` are those of the suite."""
    first = policies[0]
    both = f"{RUN}:{first} {RUN}:{policies[1]}"
    return [
        *(f"compare {RUN} --format {form}" for form in ("text", "json", "markdown")),
        *(f"compare {both} --margin 0.1 --format {form}" for form in ("text", "json")),
        f"compare {RUN}:{first} {EARLIER}:{first} --allow suite",
        *(f"compare {RUN} {EARLIER} --allow suite --format {form}" for form in ("text", "json", "markdown")),
        f"compare {RUN} {EARLIER} --alpha 0.2 --margin 0.3 --policy {first}",
        *(f"compare --gate {RUN} --format {form}" for form in ("text", "json")),
        f"compare --gate {RUN} {EARLIER} --allow suite --format markdown",
        *(f"compare --all {name} --format {form}" for form in ("text", "json")),
        *(f"list runs{end}" for end in ("", " --json", f" {first}", f" {first} --json")),
        *(f"report {RUN} --table {form}" for form in ("latex", "markdown", "csv")),
        f"report {RUN} --cite",
        f"replay --verify {RUN} --sample 0",
        f"plan {suite} --out {RUN} --detect 20 --width 10 --json",
        f"list episodes {RUN} --policy {first} --status failure --status error",
        f"list episodes {RUN} --seed 1 --json",
        f"export {RUN} --format csv --out rows.csv",
    ]


@contextlib.contextmanager
def elsewhere(folder: Path) -> Iterator[None]:
    """Works in a folder, with nothing of the user's own: no configuration, no history, no state."""
    own = {"XDG_STATE_HOME": str(folder / "state"), "ROBOGAUNTLET_CONFIG": os.devnull, "COLUMNS": "200"}
    with contextlib.chdir(folder), mock.patch.dict(os.environ, own):
        for name in ("ROBOGAUNTLET_HISTORY", "ROBOGAUNTLET_STORE", "ROBOGAUNTLET_PUBLIC_URL"):
            os.environ.pop(name, None)
        yield


def said(command: str) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of a command."""
    from robogauntlet.orchestrator.cli import main

    printed, problems, code = io.StringIO(), io.StringIO(), 0
    with (
        mock.patch.object(sys, "argv", ["robogauntlet", *command.split()]),
        contextlib.redirect_stdout(printed),
        contextlib.redirect_stderr(problems),
    ):
        try:
            main()
        except SystemExit as end:
            code = int(end.code or 0)
    return code, printed.getvalue(), problems.getvalue()


def answer(command: str, place: str) -> str:
    """A command with its exit code and what it printed, as the record has it."""
    code, printed, problems = said(command)
    parts = [f"$ {command}", f"exit code {code}"]
    parts += [f"! {line}" for line in plain(problems, place).splitlines() if line]
    if command.startswith("plan "):
        printed = _of_any_machine(printed)
    parts.append(shortened(plain(printed, place)))
    return "\n".join(parts).rstrip("\n") + "\n"


def _of_any_machine(text: str) -> str:
    """A plan's JSON without what depends on what is installed."""
    try:
        plan = json.loads(text)
    except ValueError:
        return text
    for name in ("to_play", "skipped", "unchecked"):
        plan.pop(name, None)
    for cell in plan["cells"]:
        cell.pop("missing")
    return json.dumps(plan)


def shortened(text: str) -> str:
    """A text, or the beginning of a long one with a hash of the whole."""
    if len(text) <= LONGEST:
        return text
    whole = hashlib.sha256(text.encode()).hexdigest()[:16]
    return f"{text[:LONGEST]}\n... {len(text) - LONGEST:,} characters more, {whole}\n"
