"""What `gauntlet doctor` can say is wrong, read from the code: a template for each message."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
SAID_BY = {
    "orchestrator/cli/doctor.py": {"append"},
    "orchestrator/probe.py": {"Finding"},
    "suites/plugins.py": {"reason"},
    "policies/oracles/plugins.py": {"problem", "_problem"},
    "orchestrator/environments/checking.py": {"Found", "_problems", "_other_python"},
    **{path.relative_to(ROOT).as_posix(): {"SimulatorUnavailable"} for path in (ROOT / "adapters").rglob("*.py")},
}
SAID_BY["adapters/catalog.py"] |= {"missing_reason"}
"""File to the functions that are called with a message, or that return one, or the names that one is given to."""


def templates():
    """Each message as its fixed pieces, in order; what stands between them differs."""
    found = set()
    for name, sayers in SAID_BY.items():
        tree = ast.parse((ROOT / name).read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            for value in _values(node, sayers):
                pieces = _pieces(value)
                if sum(len(re.findall(r"[a-z]{2,}", piece)) for piece in pieces) >= 2:
                    found.add(pieces)
    return found


def _values(node, sayers):
    if isinstance(node, ast.Call) and getattr(node.func, "id", getattr(node.func, "attr", None)) in sayers:
        for argument in node.args:
            yield from argument.elts if isinstance(argument, ast.Tuple) else [argument]
    elif isinstance(node, ast.Assign | ast.AnnAssign) and _name(node) in sayers:
        yield node.value
    elif isinstance(node, ast.FunctionDef) and node.name in sayers:
        yield from (inner.value for inner in ast.walk(node) if isinstance(inner, ast.Return | ast.Yield))


def _name(node):
    return getattr(node.targets[0] if isinstance(node, ast.Assign) else node.target, "id", None)


def _pieces(value):
    if isinstance(value, ast.Constant) and isinstance(value.value, str):
        return (value.value,)
    if isinstance(value, ast.JoinedStr):
        return tuple(part.value for part in value.values if isinstance(part, ast.Constant))
    return ()


def is_said(pieces, line):
    """Whether a line is this message, with something in place of what differs."""
    return re.search(".+".join(map(re.escape, pieces)), line) is not None
