"""Expressions in mapping files: names, attributes, items, calls with constants and comparisons only."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from typing import Any

from robogauntlet.suites.plugins import did_you_mean

NAMES = ("observation", "info", "reward", "terminated", "unwrapped")
"""Names in expressions: the results of reset and step, and the environment without its wrappers."""
_ALLOWED = (
    *(ast.Expression, ast.Name, ast.Load, ast.Constant, ast.UnaryOp, ast.USub, ast.Attribute, ast.Call),
    *(ast.Subscript, ast.Slice, ast.Compare, ast.Lt, ast.LtE, ast.Gt, ast.GtE),
)


def check_expression(text: str) -> str:
    """Return an expression such as `observation["goal"]`, `unwrapped.data.site("grip").xpos` or `reward >= 0.5`.

    Raises:
        ValueError: It is not an expression, or contains anything else.
    """
    try:
        nodes = list(ast.walk(ast.parse(text, mode="eval")))
    except SyntaxError:
        raise ValueError(f"'{text}' is no expression such as observation[0:3]") from None
    for node in nodes:
        hidden = isinstance(node, ast.Attribute) and node.attr.startswith("_")
        if hidden or not isinstance(node, _ALLOWED) or (isinstance(node, ast.Call) and node.keywords):
            allowed = "names, .attributes, [items], calls and comparisons, none of which begins with _"
            raise ValueError(f"'{text}': expected only {allowed}")
        if isinstance(node, ast.Name) and node.id not in NAMES:
            raise ValueError(f"'{text}': unknown name '{node.id}'{did_you_mean(node.id, NAMES)}")
    return text


def value_of(text: str, names: Mapping[str, Any]) -> Any:
    """Evaluate a checked expression.

    Raises:
        ValueError: It cannot be evaluated.
    """
    try:
        return eval(compile(ast.parse(text, mode="eval"), text, "eval"), {"__builtins__": {}}, dict(names))
    except AttributeError as error:
        known = [name for name in dir(error.obj) if not name.startswith("_")]
        raise ValueError(f"'{text}': no '{error.name}' there{did_you_mean(str(error.name), known)}") from None
    except Exception as error:  # A call may raise anything.
        raise ValueError(f"'{text}': {type(error).__name__}: {' '.join(str(error).split())}") from None
