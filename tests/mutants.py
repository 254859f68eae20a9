"""`python -m tests.mutants`: which test notices when a line of the core is wrong.

Changes one place of a module at a time (a sample, the same each time) and runs the tests of its package that need no
simulator and no Ray, until one fails. Files stay as they are: a process of its own imports the changed module. The
result, a line for each mutant with the first test that kills it, is `tests/mutants.json`; those in it are not tried
again, unless their module has changed.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import importlib
import importlib.machinery
import json
import os
import random
import resource
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import hypothesis  # noqa: F401, imported once for all mutants, as are the next
import numpy as np  # noqa: F401
import pandas as pd  # noqa: F401
import pydantic  # noqa: F401
import pytest
import scipy.stats  # noqa: F401
import sqlalchemy  # noqa: F401

from tests import ROOT

RESULT = ROOT / "tests" / "mutants.json"
TESTS = {
    "results/statistics": ("results/statistics", "results/analysis"),
    "results/analysis": ("results/analysis", "results/report", "results/test_api.py"),
    "suites": ("suites", "bad_input/test_suites.py"),
    "orchestrator/scheduling": ("orchestrator/scheduling",),
    "orchestrator/episodes": ("orchestrator/episodes",),
}
"""Package to the tests that are run for its mutants."""
LIGHT = "not simulator and not ray and not slow"
CPU_S = 240
"""CPU time after which a mutant counts as killed, for it may never end (s)."""
COMPARED: dict[type[ast.AST], type[ast.AST]] = {
    **{ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq},
    **{ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is},
    **{ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult},
    **{ast.And: ast.Or, ast.Or: ast.And},
}


def places(tree: ast.AST) -> Iterator[tuple[ast.AST, str]]:
    """Nodes that can be changed, each with what it becomes. Annotations, f-strings and `TYPE_CHECKING` are left out."""
    for node in _code(tree):
        if isinstance(node, ast.Compare) and type(node.ops[0]) in COMPARED:
            yield node, f"{type(node.ops[0]).__name__} -> {COMPARED[type(node.ops[0])].__name__}"
        elif isinstance(node, ast.BinOp | ast.BoolOp) and type(node.op) in COMPARED:
            yield node, f"{type(node.op).__name__} -> {COMPARED[type(node.op)].__name__}"
        elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
            yield node, f"{node.value} -> {not node.value}"
        elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
            yield node, f"{node.value} -> {node.value + 1}"
        elif isinstance(node, ast.If | ast.IfExp | ast.While) and "TYPE_CHECKING" not in ast.dump(node.test):
            yield node, "condition -> its negation"
        elif isinstance(node, ast.Return) and node.value is not None:
            yield node, "returned value -> None"


def _code(node: ast.AST) -> Iterator[ast.AST]:
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list") or isinstance(node, ast.JoinedStr):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                yield child
                yield from _code(child)


def change(node: Any) -> None:
    """Change a node as `places` says."""
    if isinstance(node, ast.Compare):
        node.ops[0] = COMPARED[type(node.ops[0])]()  # type: ignore[call-overload]
    elif isinstance(node, ast.BinOp | ast.BoolOp):
        node.op = COMPARED[type(node.op)]()  # type: ignore[assignment]
    elif isinstance(node, ast.Constant):
        node.value = not node.value if isinstance(node.value, bool) else node.value + 1
    elif isinstance(node, ast.Return):
        node.value = ast.Constant(None)
    else:
        node.test = ast.UnaryOp(ast.Not(), node.test)


def sample(number: int, seed: int) -> list[dict[str, Any]]:
    """A sample of all mutants: module, place in it, what it becomes, and a hash of the module's text."""
    found = []
    for package in TESTS:
        for path in sorted((ROOT / package).rglob("*.py")):
            text = path.read_text(encoding="utf-8")
            version = hashlib.sha256(text.encode()).hexdigest()[:8]
            for place, (node, becomes) in enumerate(places(ast.parse(text))):
                file, line = str(path.relative_to(ROOT)), getattr(node, "lineno", 0)
                found.append({"file": file, "version": version, "place": place, "line": line, "change": becomes})
    return sorted(random.Random(seed).sample(found, number), key=lambda one: (one["file"], one["place"]))


class _First:
    """Notes the first test that fails."""

    failed = ""

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.failed and not self.failed:
            self.failed = report.nodeid.removeprefix("tests/")

    def pytest_collectreport(self, report: Any) -> None:
        if report.failed and not self.failed:
            self.failed = f"{report.nodeid.removeprefix('tests/')} (import)"


def killer(mutant: dict[str, Any] | None, tests: Sequence[str]) -> str:
    """The first test that fails with the mutant, "import" or "time" if none begins or ends, "" if it survives."""
    reading, writing = os.pipe()
    if (child := os.fork()) == 0:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os.dup2(1, 2)
        resource.setrlimit(resource.RLIMIT_CPU, (CPU_S, CPU_S))
        first = _First()
        try:
            if mutant is not None:
                _import_changed(mutant)
        except Exception:
            os.write(writing, b"import")
            os._exit(0)
        options = ["-x", "-q", "-p", "no:cacheprovider", "-m", LIGHT]
        code = pytest.main([*options, *(f"tests/{name}" for name in tests)], plugins=[first])
        os.write(writing, (first.failed or (f"pytest ends with {int(code)}" if code else "") or " ").encode())
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        said = pipe.read()
    os.waitpid(child, 0)
    return said.strip() if said else "time"


def _import_changed(mutant: dict[str, Any]) -> None:
    module = "robogauntlet." + mutant["file"].removesuffix(".py").removesuffix("/__init__").replace("/", ".")
    tree = ast.parse((ROOT / mutant["file"]).read_text(encoding="utf-8"))
    change([*places(tree)][mutant["place"]][0])
    ast.fix_missing_locations(tree)
    loader: Any = importlib.machinery.SourceFileLoader
    usual = loader.get_code
    loader.get_code = lambda self, name: compile(tree, self.path, "exec") if name == module else usual(self, name)
    importlib.import_module(module)  # before pytest, which has a loader of its own


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; exit code 1 if the tests fail without any mutant."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument("--number", type=int, default=200, help="mutants in the sample (200)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the sample")
    parser.add_argument("--package", action="append", choices=TESTS, help="only mutants of this package; repeatable")
    options = parser.parse_args(arguments)
    os.chdir(ROOT)
    known = json.loads(RESULT.read_text(encoding="utf-8")) if RESULT.exists() else []
    results = {tuple(list(one.values())[:-1]): one for one in known}
    mutants = sample(options.number, options.seed)
    kept = [results[key] for one in mutants if (key := tuple(one.values())) in results]
    for package in options.package or TESTS:
        left = [one for one in mutants if one["file"].startswith(package) and tuple(one.values()) not in results]
        if left and (broken := killer(None, TESTS[package])):
            print(f"{package}: {broken} fails without a mutant")
            return 1
        for mutant in left:
            began = time.monotonic()
            own = f"{Path(mutant['file']).parent}/test_{Path(mutant['file']).stem}.py"
            by = killer(mutant, [own]) if (ROOT / "tests" / own).exists() else ""
            by = by or killer(mutant, TESTS[package])
            kept.append({**mutant, "killed by": by})
            kept.sort(key=lambda one: (one["file"], one["place"]))
            lines = ",\n".join(json.dumps(one) for one in kept)
            RESULT.write_text(f"[\n{lines}\n]\n", encoding="utf-8")
            place = f"{mutant['file']}:{mutant['line']} {mutant['change']}"
            print(f"{place}: {by or 'SURVIVES'}, {time.monotonic() - began:.0f} s", flush=True)
    survivors = [one for one in kept if not one["killed by"]]
    print(f"{len(kept) - len(survivors)} of {len(kept)} mutants are killed; these survive:")
    print("\n".join(f"{one['file']}:{one['line']} {one['change']}" for one in survivors))
    return 0


if __name__ == "__main__":
    sys.exit(main())
