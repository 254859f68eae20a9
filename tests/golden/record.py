"""The record of a kind: files by name, made from its kept run by today's tree."""

from __future__ import annotations

import difflib
import hashlib
import shutil
import tempfile
from collections.abc import Iterable
from itertools import chain
from pathlib import Path

from robogauntlet.orchestrator.runs.plan import make_plan
from robogauntlet.results.record import outcome_row, rows_hash
from robogauntlet.results.report import write_report
from tests.golden.commands import EARLIER, RUN, answer, commands, elsewhere, said, shortened
from tests.golden.kept import HERE, KeptRun, build_earlier
from tests.golden.normal import json_text, page_sentences, plain

RECORDS = HERE / "records"
IMPORTED = "imported"
"""The kind whose run is compared as it arrives from elsewhere."""
SUFFIX = ".zip"
"""Of an exported run."""
PLAN = "plan.json"
SHOWN = 60
"""Lines of a difference of a file."""


class Unplanned(Exception):
    """A suite whose plan needs something that is not installed."""


def identities(suite: Path) -> dict[str, object]:
    """What a plan made anew says: hash of the suite, digests of policies, and ids of episodes.

    Raises:
        Unplanned: A policy's package is not installed.
    """
    plan = make_plan(suite, require_installed=False, start=False)
    if plan.unchecked:
        raise Unplanned("; ".join(f"{name}: {reason}" for name, reason in plan.unchecked.items()))
    cells = {
        f"{cell.policy}, {cell.task}, {cell.condition}": [
            cell.protocol.horizon,
            cell.episode(plan.suite.seeds.start).id,
            cell.episode(plan.suite.seeds.start).pair_id,
            _hash(cell.episode(seed).id for seed in plan.suite.seeds),
        ]
        for cell in plan.cells
    }
    return {
        "suite_hash": plan.suite_hash,
        "policy digests": {name: source.digest for name, source in plan.sources.items()},
        "unsupported": [f"{gap.axis} in {gap.task}: {gap.reason}" for gap in plan.unsupported],
        "notes": [*plan.notes],
        "warnings": [*plan.warnings],
        "cells: horizon, first id, first pair, all ids": cells,
    }


def _hash(texts: Iterable[str]) -> str:
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()[:16]


def made(kind: str) -> tuple[dict[str, str], str | None]:
    """The record of a kind as today's tree makes it; and why it lacks `PLAN`, if it needs what is not installed."""
    kept, files, unplanned = KeptRun(kind), dict[str, str](), None
    try:
        files[PLAN] = json_text(identities(kept.suite))
    except Unplanned as reason:
        unplanned = str(reason)
    rows = [outcome_row(row) for row in kept.rows]
    ids = [[row.episode_id, row.episode.id, row.pair_id, row.episode.pair_id] for row in kept.rows]
    facts = {
        "rows": len(rows),
        "rows_hash": rows_hash(rows),
        "rows with another id than their episode": sum(a != b or c != d for a, b, c, d in ids),
    }
    with tempfile.TemporaryDirectory(prefix="golden-") as name, elsewhere(Path(name)):
        place = str(Path(name).resolve())
        build_earlier(kind, Path(EARLIER))
        folder = kept.build(Path(RUN))
        if kind == IMPORTED:
            _import_from_elsewhere(folder)
        write_report(folder)
        for file in ("summary.json", "report.md", "cells.csv"):
            files[file] = plain((folder / file).read_text(encoding="utf-8"), place)
        page = (folder / "report.html").read_text(encoding="utf-8")
        files["page.txt"] = plain(page_sentences(page, files["report.md"]), place)
        document = kept.document
        asked = commands(kept.suite, document.suite.name, [policy.name for policy in document.suite.policies])
        answers = [answer(command, place) for command in asked]
        files["commands.txt"] = "\n".join(answers).replace(str(kept.suite), "SUITE")
        for file in sorted(Path().glob("*.json")):
            files[file.name] = shortened(plain(file.read_text(encoding="utf-8"), place))
        table = Path("rows.csv").read_text(encoding="utf-8").splitlines()
        facts |= {"columns of csv": table[0], "lines of csv": len(table), "csv": _hash(sorted(table))}
    return {**files, "rows.json": json_text(facts)}, unplanned


def _import_from_elsewhere(folder: Path) -> None:
    """Put in a run's place what arrives when it is exported and imported."""
    Path("exported").mkdir()
    file = f"exported/run{SUFFIX}"
    exported = said(f"export {folder} --out {file}")
    shutil.rmtree(folder)
    imported = said(f"import {file} --out {folder}")
    assert (exported[0], imported[0]) == (0, 0), exported[2] + imported[2]


def differences(kind: str) -> tuple[list[str], str | None]:
    """Lines on how today's record of a kind differs from the kept one; and why its plan is not compared, if so."""
    kept, (today, unplanned) = read(kind), made(kind)
    if unplanned is not None:
        kept.pop(PLAN, None)
    names = sorted({*kept, *today})
    lines = [_difference(f"{kind}/{name}", kept.get(name, ""), today.get(name, "")) for name in names]
    return [*chain.from_iterable(lines)], unplanned


def _difference(name: str, kept: str, today: str) -> list[str]:
    sides = (f"kept: {name}", f"today: {name}")
    lines = [*difflib.unified_diff(kept.splitlines(), today.splitlines(), *sides, n=1, lineterm="")]
    more = [f"... {len(lines) - SHOWN:,} lines more"] if len(lines) > SHOWN else []
    return lines[:SHOWN] + more


def read(kind: str) -> dict[str, str]:
    """The kept record of a kind."""
    return {path.name: path.read_text(encoding="utf-8") for path in sorted((RECORDS / kind).glob("*.*"))}


def write(kind: str) -> None:
    """Make the record of a kind anew. What cannot be made here stays as it was."""
    folder = RECORDS / kind
    folder.mkdir(parents=True, exist_ok=True)
    files, unplanned = made(kind)
    kept_though = {PLAN} if unplanned else set()
    for name in read(kind).keys() - files.keys() - kept_though:
        (folder / name).unlink()
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
