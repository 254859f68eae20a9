"""Expressions in mapping files. They reach numbers and arrays only, and are evaluated here, not by Python.

observation["goal"][0:3]            items of what `reset` and `step` returned
unwrapped.data.site("grip").xpos    numbers of MuJoCo's data and model, by name
unwrapped.robot.position            an attribute that the mapping declares under `reads`
norm(observation[0:3] - 0.5) < 0.1  arithmetic, comparisons, `and`, `or`, `not`, and the functions of `FUNCTIONS`
"""

from __future__ import annotations

import ast
import inspect
import operator
import warnings
from collections.abc import Callable, Collection, Mapping
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np

from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.support.text import visible

NAMES = ("observation", "info", "reward", "terminated", "unwrapped")
"""Names in expressions: the results of reset and step, and the environment without its wrappers."""
FUNCTIONS: dict[str, Callable[[Any], Any]] = {
    **{"abs": np.abs, "all": np.all, "any": np.any, "cos": np.cos, "max": np.max, "mean": np.mean, "min": np.min},
    **{"norm": np.linalg.norm, "sin": np.sin, "sqrt": np.sqrt, "sum": np.sum},
}
"""Functions of one number or array."""
MUJOCO = ("data", "model")
"""Attributes of a MuJoCo environment whose numbers need no declaration."""
KINDS = ("actuator", "body", "camera", "geom", "joint", "light", "sensor", "site", "tendon")
"""What is found by name in them."""
LONGEST = 1_000
"""Characters of an expression."""
LARGEST = 1_000_000
"""Elements of an array."""
_DEEPEST = 40
_ARITHMETIC: dict[type, Callable[[Any, Any], Any]] = {
    **{ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv},
    **{ast.Lt: operator.lt, ast.LtE: operator.le, ast.Gt: operator.gt, ast.GtE: operator.ge},
    **{ast.Eq: operator.eq, ast.NotEq: operator.ne},
}
_ALLOWED = "names, [items], numbers, + - * /, comparisons, 'and', 'or', 'not'"


def check_expression(text: str) -> str:
    """Return an expression that the rules of this module allow, but for what its mapping has to declare.

    Raises:
        ValueError: It is not an expression, or contains anything else.
    """
    _parsed(text)
    return text


def check_attribute(path: str) -> str:
    """Return a path of attributes such as `robot.position`, as a mapping declares it.

    Raises:
        ValueError: It is something else, or one of the names begins with _.
    """
    names = path.split(".")
    if len(path) > LONGEST or not all(name.isidentifier() and not name.startswith("_") for name in names):
        raise ValueError(f"'{path[:LONGEST]}': expected attributes such as robot.position, none of which begins with _")
    return path


def undeclared(text: str, declared: Collection[str]) -> str | None:
    """Return the first attribute of the environment that an expression reads without a declaration."""
    return next((path for path in _parsed(text)[1] if path not in declared), None)


def value_of(text: str, names: Mapping[str, Any], declared: Collection[str] = ()) -> Any:
    """Evaluate an expression to a number or an array.

    Args:
        text: The expression.
        names: Values of `NAMES`.
        declared: Attributes of the environment that may be read, such as `robot.position`.

    Raises:
        ValueError: It cannot be evaluated.
    """
    try:
        with np.errstate(all="ignore"):
            return _number(_Reading(names, declared).value(_parsed(text)[0]))
    except AttributeError as error:
        known = [name for name in dir(error.obj) if not name.startswith("_")]
        raise ValueError(f"'{_shown(text)}': no '{error.name}' there{did_you_mean(str(error.name), known)}") from None
    except Exception as error:  # An environment's attribute may raise anything.
        problem = str(error) if type(error) is ValueError else f"{type(error).__name__}: {error}"
        raise ValueError(f"'{_shown(text)}': {visible(' '.join(problem.split()))}") from None


def _shown(text: str) -> str:
    return visible(" ".join(text[:LONGEST].split()))


@lru_cache(1024)
def _parsed(text: str) -> tuple[ast.expr, tuple[str, ...]]:
    """Return an expression's tree, checked, and the environment's attributes that it reads. Raises ValueError."""
    if len(text) > LONGEST:
        raise ValueError(f"expected an expression of {LONGEST} characters at most, got {len(text)}")
    shown = _shown(text)
    try:
        with warnings.catch_warnings(action="ignore"):
            tree = ast.parse(text, mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise ValueError(f"'{shown}' is no expression such as observation[0:3]") from None
    paths: list[str] = []
    try:
        _check(tree, paths, _DEEPEST)
    except ValueError as error:
        raise ValueError(f"'{shown}': {error}") from None
    return tree, tuple(paths)


def _check(node: ast.AST, paths: list[str], depth: int) -> None:
    """Check a node and what is below it, and collect the environment's attributes. Raises ValueError."""
    if not depth:
        raise ValueError(f"expected {_DEEPEST} levels of brackets and operators at most")
    inner: list[ast.expr | None]
    match node:
        case ast.Name(id="unwrapped"):
            raise ValueError("expected one of its attributes, such as unwrapped.data.qpos")
        case ast.Name(id=name):
            if name not in NAMES:
                raise ValueError(f"unknown name '{name}'{did_you_mean(name, NAMES)}")
            inner = []
        case ast.Constant(value=bool() | int() | float()):
            inner = []
        case ast.UnaryOp(op=ast.USub() | ast.UAdd() | ast.Not(), operand=operand):
            inner = [operand]
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _ARITHMETIC:
            inner = [left, right]
        case ast.Compare(left=left, ops=ops, comparators=others) if all(type(op) in _ARITHMETIC for op in ops):
            inner = [left, *others]
        case ast.BoolOp(values=values):
            inner = [*values]
        case ast.Subscript(value=value, slice=key):
            parts = key.elts if isinstance(key, ast.Tuple) else [key]
            slices = [bound for part in parts if isinstance(part, ast.Slice) for bound in _bounds(part)]
            inner = [
                value,
                *slices,
                *(part for part in parts if not isinstance(part, ast.Slice) and not _is_text(part)),
            ]
        case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]) if name in FUNCTIONS:
            inner = [argument]
        case ast.Call():
            known = ", ".join(sorted(FUNCTIONS))
            raise ValueError(f'expected only unwrapped.data.KIND("NAME").FIELD and calls of one argument of: {known}')
        case ast.Attribute():
            if _named(node) is None:
                paths.extend(_attributes(node))
            inner = []
        case _:
            raise ValueError(f"expected only {_ALLOWED}, attributes of unwrapped and functions of the list")
    for one in inner:
        if one is not None:
            _check(one, paths, depth - 1)


def _attributes(node: ast.Attribute) -> list[str]:
    """Return the declaration that an attribute needs: none for MuJoCo's numbers. Raises ValueError."""
    path: list[str] = []
    below: ast.expr = node
    while isinstance(below, ast.Attribute):
        path.insert(0, below.attr)
        below = below.value
    if not isinstance(below, ast.Name) or below.id != "unwrapped":
        kinds = ", ".join(KINDS)
        raise ValueError(f'expected attributes of unwrapped only, or unwrapped.data.KIND("NAME").FIELD; kinds: {kinds}')
    name = check_attribute(".".join(path))
    return [] if path[0] in MUJOCO and len(path) == 2 else [name]


def _named(node: ast.Attribute) -> tuple[str, str, str | int, str] | None:
    """Return the parts of `unwrapped.data.site("grip").xpos`, or None for another attribute."""
    match node:
        case ast.Attribute(
            value=ast.Call(
                func=ast.Attribute(value=ast.Attribute(value=ast.Name(id="unwrapped"), attr=source), attr=kind),
                args=[ast.Constant(value=str() | int() as name)],
                keywords=[],
            ),
            attr=field,
        ) if source in MUJOCO and kind in KINDS and not field.startswith("_"):
            return source, kind, name, field
    return None


def _bounds(part: ast.Slice) -> list[ast.expr | None]:
    return [part.lower, part.upper, part.step]


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


class _Reading:
    """Evaluates checked trees over one step's values."""

    def __init__(self, names: Mapping[str, Any], declared: Collection[str]) -> None:
        self._names, self._declared = names, declared

    def value(self, node: ast.AST | None) -> Any:
        match node:
            case ast.Name(id=name):
                return self._names[name]
            case ast.Constant(value=value):
                return _number(value)
            case ast.UnaryOp(op=op, operand=operand):
                value = _number(self.value(operand))
                return not _truth(value) if isinstance(op, ast.Not) else -value if isinstance(op, ast.USub) else value
            case ast.BinOp(left=left, op=op, right=right):
                return _joined(op, self.value(left), self.value(right))
            case ast.Compare(left=left, ops=ops, comparators=others):
                values = [self.value(one) for one in (left, *others)]
                found = [_joined(op, *pair) for op, pair in zip(ops, pairwise(values), strict=True)]
                return found[0] if len(found) == 1 else all(map(_truth, found))
            case ast.BoolOp(op=op, values=parts):
                return (all if isinstance(op, ast.And) else any)(_truth(self.value(part)) for part in parts)
            case ast.Subscript(value=value, slice=key):
                return _item(self.value(value), self._key(key))
            case ast.Call(func=ast.Name(id=name), args=[argument]):
                return FUNCTIONS[name](_number(self.value(argument)))
            case ast.Attribute():
                return self._attribute(node)
        raise ValueError("expected an expression")

    def _key(self, node: ast.AST) -> Any:
        """Return what is between brackets: a text, a whole number, a slice, or several of them."""
        match node:
            case ast.Constant(value=str() as text):
                return text
            case ast.Tuple(elts=parts):
                return tuple(self._key(part) for part in parts)
            case ast.Slice():
                return slice(*(None if bound is None else self._key(bound) for bound in _bounds(node)))
        number = float(_number(self.value(node)))
        if not number.is_integer():
            raise ValueError(f"expected a whole number between brackets, got {number:g}")
        return int(number)

    def _attribute(self, node: ast.Attribute) -> Any:
        named = _named(node)
        if named:
            source, kind, name, field = named
            return _number(getattr(getattr(self._mujoco(source), kind)(name), field))
        (path,) = _attributes(node) or [""]
        if not path:
            assert isinstance(node.value, ast.Attribute)
            return _number(getattr(self._mujoco(node.value.attr), node.attr))
        if path not in self._declared:
            raise ValueError(f"'{path}' is not declared; add it to `reads` of the mapping")
        value = self._names["unwrapped"]
        for part in path.split("."):
            value = getattr(value, part)
            if inspect.ismodule(value) or inspect.isclass(value) or inspect.isroutine(value):
                raise ValueError(f"'{part}' of '{path}' is no attribute with numbers")
        return _number(value)

    def _mujoco(self, source: str) -> Any:
        """Return MuJoCo's data or model of the environment."""
        import mujoco

        found = getattr(self._names["unwrapped"], source)
        if not isinstance(found, (mujoco.MjData, mujoco.MjModel)):
            raise ValueError(f"unwrapped.{source} is not of MuJoCo")
        return found


def _number(value: Any) -> Any:
    """Return a number or an array of numbers, of bounded size. Raises ValueError."""
    array = np.asarray(value)
    if array.dtype.kind not in "biuf" or array.size > LARGEST:
        found = f"{array.size} elements" if array.dtype.kind in "biuf" else type(value).__name__
        raise ValueError(f"expected a number or an array of at most {LARGEST} numbers, found {found}")
    return array.astype(np.float64) if array.dtype.kind != "b" else array


def _truth(value: Any) -> bool:
    return bool(_number(value))


def _joined(op: ast.AST, left: Any, right: Any) -> Any:
    left, right = _number(left), _number(right)
    if np.prod(np.broadcast_shapes(left.shape, right.shape), dtype=object) > LARGEST:
        raise ValueError(f"expected a result of at most {LARGEST} numbers")
    return _ARITHMETIC[type(op)](left, right)


def _item(value: Any, key: Any) -> Any:
    """Return an item of a mapping, a sequence or an array."""
    if isinstance(key, str) or not isinstance(value, (Mapping, list, tuple)):
        expected = isinstance(value, Mapping) if isinstance(key, str) else hasattr(value, "__array__")
        if not expected:
            raise ValueError(f"a {type(value).__name__} has no item {key!r}")
    return value[key] if isinstance(value, (Mapping, list, tuple)) else np.asarray(value)[key]
