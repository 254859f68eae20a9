"""The messages of `robogauntlet check installation`, read from the code: a template for each."""

import ast
import re

from tests import ROOT

SOURCES = {
    "orchestrator/cli/check/installation.py": {"append"},
    "orchestrator/environments/probe.py": {"Finding"},
    "src/robogauntlet/support/child_process.py": {"_how_it_ended"},
    "suites/plugins.py": {"reason", "_why_unusable"},
    "policies/oracles/plugins.py": {"problem", "_problem"},
    "orchestrator/environments/check.py": {"EnvironmentCheck", "_problems", "_other_python"},
    **{path.relative_to(ROOT).as_posix(): {"SimulatorUnavailable"} for path in (ROOT / "adapters").rglob("*.py")},
}
SOURCES["adapters/catalog.py"] |= {"missing_reason"}
"""File to the functions that are called with a message, or return one, or the names that one is assigned to."""


def templates():
    """Each message as its fixed pieces, in order; the text between them varies."""
    messages = set()
    for name, functions in SOURCES.items():
        tree = ast.parse((ROOT / name).read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            for value in _values(node, functions):
                pieces = _pieces(value)
                if sum(len(re.findall(r"[a-z]{2,}", piece)) for piece in pieces) >= 2:
                    messages.add(pieces)
    return messages


def _values(node, functions):
    if isinstance(node, ast.Call) and getattr(node.func, "id", getattr(node.func, "attr", None)) in functions:
        for argument in node.args:
            yield from argument.elts if isinstance(argument, ast.Tuple) else [argument]
    elif isinstance(node, ast.Assign | ast.AnnAssign) and _name(node) in functions:
        yield node.value
    elif isinstance(node, ast.FunctionDef) and node.name in functions:
        yield from (inner.value for inner in ast.walk(node) if isinstance(inner, ast.Return | ast.Yield))


def _name(node):
    return getattr(node.targets[0] if isinstance(node, ast.Assign) else node.target, "id", None)


def _pieces(value):
    if isinstance(value, ast.Constant) and isinstance(value.value, str):
        return (value.value,)
    if isinstance(value, ast.JoinedStr):
        return tuple(part.value for part in value.values if isinstance(part, ast.Constant))
    return ()


def matches(pieces, line):
    """Whether a line is this message, with any text between its pieces."""
    return re.search(".+".join(map(re.escape, pieces)), line) is not None
