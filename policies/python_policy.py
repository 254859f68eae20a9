"""Any Python class, factory or function as a policy.

A plain function has parameters named `images, proprioception, instruction` and returns a chunk; any other callable
builds a policy of `robogauntlet.policies.contract` from the options.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import inspect
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.policies.contract import (
    Decision,
    Policy,
    PolicyError,
    PolicyFiles,
    PolicyInput,
    PolicyKind,
    PolicySpec,
    Query,
    StatelessPolicy,
    check_chunk,
)
from robogauntlet.suites.episode import content_hash
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.support.errors import describe

NAME = "python"
PARAMETERS = ("images", "proprioception", "instruction")
"""Parameters of a plain function: camera to (size, size, 3) uint8, (8,) float64, text."""
MAX_CHUNK_LENGTH = 1000
MAX_SOURCES = 1000
"""Largest number of a package's files that are hashed."""
Act = Callable[..., FloatArray]


class FunctionPolicy(StatelessPolicy):
    """A plain function of the observation; `name` is for messages."""

    spec = PolicySpec(PolicyInput.OBSERVATION, MAX_CHUNK_LENGTH)

    def __init__(self, act: Act, name: str) -> None:
        self._act, self._name = act, name

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """Call the function for each query. Raises PolicyError if the result is not a chunk."""
        decisions = []
        for query in queries:
            assert query.observation is not None
            actions = self._act(**{name: getattr(query.observation, name) for name in PARAMETERS})
            try:
                decisions.append(Decision(check_chunk(actions)))
            except PolicyError as error:
                raise type(error)(f"{self._name}: {error}") from None
        return decisions


class _Place:
    """A callable named by a suite's options: module, name, folder and further files. Raises PolicyError."""

    def __init__(self, options: Mapping[str, Any]) -> None:
        self.text = options.get("callable")
        expected = f"policy '{NAME}': expected option callable: module:Name"
        if not isinstance(self.text, str):
            raise PolicyError(f"{expected}, got {self.text!r}")
        self.module, _, self.name = self.text.partition(":")
        if not all(part.isidentifier() for part in (*self.module.split("."), *self.name.split("."))):
            raise PolicyError(f"{expected}, got '{self.text}'")
        self.options = options.get("options", {})
        if not isinstance(self.options, Mapping) or not all(isinstance(key, str) for key in self.options):
            raise PolicyError(f"policy '{NAME}': expected option options: a mapping by name, got {self.options!r}")
        folder, files = options.get("folder", "."), options.get("files", ())
        if not isinstance(folder, str) or not Path(folder).is_dir():
            raise PolicyError(f"policy '{NAME}': expected option folder: a folder, got {folder!r}")
        self.folder = Path(folder).resolve()
        files = [files] if isinstance(files, str) else files
        if not isinstance(files, list | tuple) or not all(isinstance(file, str) for file in files):
            raise PolicyError(f"policy '{NAME}': expected option files: paths below the folder, got {files!r}")
        self.files = [self._below(file) for file in files]

    def _below(self, file: str) -> Path:
        path = (self.folder / file).resolve()
        if not path.is_file() or not path.is_relative_to(self.folder):
            raise PolicyError(
                f"policy '{NAME}': expected a file below '{self.folder.name}' as option files, got '{file}'"
            )
        return path

    @property
    def origin(self) -> Path:
        """The module's file, found without importing it: below the folder, else where Python finds its top package."""
        local = self.folder.joinpath(*self.module.split("."))
        candidates = [local.with_name(f"{local.name}.py"), local / "__init__.py"]
        top, *rest = self.module.split(".")
        try:
            spec = importlib.util.find_spec(top)
        except (ImportError, ValueError):
            spec = None
        if spec is not None and spec.submodule_search_locations and rest:
            for location in spec.submodule_search_locations:
                inner = Path(location).joinpath(*rest)
                candidates += [inner.with_name(f"{inner.name}.py"), inner / "__init__.py"]
        elif spec is not None and spec.origin and not rest:
            candidates.append(Path(spec.origin))
        origin = next((path for path in candidates if path.is_file() and path.suffix == ".py"), None)
        if origin is None:
            raise PolicyError(
                f"policy '{self.text}': expected a module '{self.module}' in '{self.folder}' or installed, found none; "
                "give its folder by option folder"
            )
        return origin.resolve()

    def sources(self) -> list[Path]:
        """Return the module's file, or all Python files of its package."""
        origin = self.origin
        if "." not in self.module and origin.name != "__init__.py":
            return [origin]
        sources = sorted(origin.parent.rglob("*.py"))
        if len(sources) > MAX_SOURCES:
            raise PolicyError(
                f"policy '{self.text}': expected {MAX_SOURCES} files in its package at most, got {len(sources)}; "
                "put the policy into a module of its own"
            )
        return sources


def _digest(options: Mapping[str, Any]) -> str:
    place = _Place(options)
    root = place.origin.parent
    try:
        sources = {path.relative_to(root).as_posix(): _hash(path, text=True) for path in place.sources()}
        files = {path.relative_to(place.folder).as_posix(): _hash(path) for path in place.files}
        content = {"policy": NAME, "callable": place.text, "sources": sources, "files": files}
        return content_hash({**content, "options": dict(place.options)})
    except (TypeError, ValueError):
        raise PolicyError(f"policy '{place.text}': options must be plain numbers, text, lists and mappings") from None
    except OSError as error:
        raise PolicyError(f"policy '{place.text}': {error.filename}: {error.strerror}") from None


def _hash(path: Path, *, text: bool = False) -> str:
    content = path.read_bytes()
    return hashlib.sha256(b"\n".join(content.splitlines()) if text else content).hexdigest()


def _import(place: _Place) -> Any:
    """Import the callable."""
    origin, top = place.origin, place.module.partition(".")[0]
    if origin.is_relative_to(place.folder) and str(place.folder) not in sys.path:
        sys.path.append(str(place.folder))  # last, so that its modules hide no others
    importlib.invalidate_caches()
    try:
        module = importlib.import_module(place.module)
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        raise PolicyError(f"policy '{place.text}': importing '{place.module}' raised {describe(error)}") from None
    if Path(module.__file__ or "").resolve() != origin:
        raise PolicyError(
            f"policy '{place.text}': expected module '{place.module}' from {origin}, got another of that name from "
            f"{module.__file__}; rename '{top}'"
        )
    target: Any = module
    for part in place.name.split("."):
        if not hasattr(target, part):
            names = [name for name in vars(target) if not name.startswith("_")]
            raise PolicyError(f"policy '{place.text}': expected '{part}', found none{did_you_mean(part, names)}")
        target = getattr(target, part)
    if not callable(target):
        raise PolicyError(f"policy '{place.text}': expected a class or a function, got a {type(target).__name__}")
    return target


def _load(options: Mapping[str, Any]) -> Policy:
    place = _Place(options)
    target = _import(place)
    if _is_plain(target):
        try:
            inspect.signature(target).bind(**dict.fromkeys(PARAMETERS), **place.options)
        except TypeError as error:
            raise PolicyError(f"policy '{place.text}': options do not fit the function: {error}") from None
        return FunctionPolicy(partial(target, **place.options), place.name)
    try:
        policy: Any = target(**place.options)
    except Exception as error:  # it may raise anything
        raise PolicyError(f"policy '{place.text}': building it raised {describe(error)}") from None
    if not hasattr(policy, "act") and callable(policy) and _is_plain(policy):
        return FunctionPolicy(policy, place.name)
    for name in ("reset", "act", "finish"):
        if not callable(getattr(policy, name, None)):
            raise PolicyError(
                f"policy '{place.text}': expected a policy with method {name} (see robogauntlet.policies.contract), "
                f"or a function of {', '.join(PARAMETERS)}; got a {type(policy).__name__}"
            )
    if not isinstance(getattr(policy, "spec", None), PolicySpec):
        raise PolicyError(
            f"policy '{place.text}': expected attribute spec, a robogauntlet.policies.contract.PolicySpec; got none"
        )
    return policy


def _is_plain(target: Any) -> bool:
    """Whether the callable is a plain function of the observation."""
    if inspect.isclass(target):
        return False
    try:
        parameters = inspect.signature(target).parameters
    except (TypeError, ValueError):
        return False
    return all(name in parameters for name in PARAMETERS)


def _files(options: Mapping[str, Any]) -> PolicyFiles:
    place = _Place(options)
    read = dict.fromkeys((*place.sources(), *place.files))
    # Installed modules are expected on every node.
    return PolicyFiles({"folder": place.folder}, tuple(path for path in read if path.is_relative_to(place.folder)))


KIND = PolicyKind(
    name=NAME,
    summary="a Python class, factory or function",
    load=_load,
    digest=_digest,
    options={
        "callable": "module:Name of a class or factory of policies, or of a function of the observation",
        "options": "its keyword arguments",
        "folder": "folder of the module if it is not installed; by default the working directory",
        "files": "other files below the folder that it reads, such as weights; they count for its digest",
    },
    files=_files,
)
