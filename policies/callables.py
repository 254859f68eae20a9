"""Any Python class, factory or function as a policy.

A plain function takes `images, proprioception, instruction` (named so) and returns a chunk; anything else that can be
called makes a policy of `policies.contract` from the options.
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

from adapters.contract import FloatArray
from policies.contract import (
    Decision,
    Policy,
    PolicyError,
    PolicyFiles,
    PolicyKind,
    PolicySpec,
    Query,
    Sees,
    StatelessPolicy,
    check_chunk,
)
from suites.plugins import nearest
from suites.vocabulary import content_hash

NAME = "python"
PARAMETERS = ("images", "proprioception", "instruction")
"""Of a plain function: camera to (size, size, 3) uint8, (8,) float64, text."""
LONGEST_CHUNK = 1000
MOST_SOURCES = 1000
"""Files of a package that are hashed at most."""
Act = Callable[..., FloatArray]


class FunctionPolicy(StatelessPolicy):
    """A plain function of what is seen."""

    spec = PolicySpec(Sees.OBSERVATION, LONGEST_CHUNK)

    def __init__(self, act: Act, name: str) -> None:
        """Args: act: see the module; name: for messages."""
        self._act, self._name = act, name

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """What the function returns for each query.

        Raises:
            PolicyError: That is no chunk.
        """
        return [self._decide(query) for query in queries]

    def _decide(self, query: Query) -> Decision:
        seen = query.observation
        assert seen is not None
        actions = self._act(images=seen.images, proprioception=seen.proprioception, instruction=seen.instruction)
        try:
            return Decision(check_chunk(actions))
        except PolicyError as error:
            raise type(error)(f"{self._name}: {error}") from None


class _Place:
    """Where a callable is: module, name in it, folder, and what is read besides."""

    def __init__(self, options: Mapping[str, Any]) -> None:
        """Raises PolicyError."""
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
        """The module's file, found without running it: below the folder, else where Python finds its top package.

        Raises:
            PolicyError: There is none.
        """
        own = self.folder.joinpath(*self.module.split("."))
        candidates = [own.with_name(f"{own.name}.py"), own / "__init__.py"]
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
        found = next((path for path in candidates if path.is_file() and path.suffix == ".py"), None)
        if found is None:
            raise PolicyError(
                f"policy '{self.text}': expected a module '{self.module}' in '{self.folder}' or installed, found none; "
                "give its folder by option folder"
            )
        return found.resolve()

    def sources(self) -> list[Path]:
        """The module's file, or all Python files of its package.

        Raises:
            PolicyError: There is none, or too many.
        """
        origin = self.origin
        if "." not in self.module and origin.name != "__init__.py":
            return [origin]
        found = sorted(origin.parent.rglob("*.py"))
        if len(found) > MOST_SOURCES:
            raise PolicyError(
                f"policy '{self.text}': expected {MOST_SOURCES} files in its package at most, got {len(found)}; "
                "put what acts into a module of its own"
            )
        return found


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


def _found(place: _Place) -> Any:
    """What the callable's name stands for."""
    origin, top = place.origin, place.module.partition(".")[0]
    if origin.is_relative_to(place.folder) and str(place.folder) not in sys.path:
        sys.path.append(str(place.folder))  # last: what lies there must hide nothing that others import
    importlib.invalidate_caches()
    try:
        module = importlib.import_module(place.module)
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        raise PolicyError(f"policy '{place.text}': importing '{place.module}' raised {_named(error)}") from None
    if Path(module.__file__ or "").resolve() != origin:
        raise PolicyError(
            f"policy '{place.text}': expected module '{place.module}' from {origin}, got another of that name from "
            f"{module.__file__}; rename '{top}'"
        )
    found: Any = module
    for part in place.name.split("."):
        if not hasattr(found, part):
            there = [name for name in vars(found) if not name.startswith("_")]
            raise PolicyError(f"policy '{place.text}': expected '{part}', found none{nearest(part, there)}")
        found = getattr(found, part)
    if not callable(found):
        raise PolicyError(f"policy '{place.text}': expected a class or a function, got a {type(found).__name__}")
    return found


def _load(options: Mapping[str, Any]) -> Policy:
    place = _Place(options)
    found = _found(place)
    if _is_plain(found):
        _check_options(found, place)
        return FunctionPolicy(partial(found, **place.options), place.name)
    try:
        made = found(**place.options)
    except Exception as error:  # it may raise anything
        raise PolicyError(f"policy '{place.text}': making it raised {_named(error)}") from None
    if not hasattr(made, "act") and callable(made) and _is_plain(made):
        return FunctionPolicy(made, place.name)
    for name in ("reset", "act", "finish"):
        if not callable(getattr(made, name, None)):
            raise PolicyError(
                f"policy '{place.text}': expected a policy with method {name} (see policies.contract), or a function "
                f"of {', '.join(PARAMETERS)}; got a {type(made).__name__}"
            )
    if not isinstance(getattr(made, "spec", None), PolicySpec):
        raise PolicyError(f"policy '{place.text}': expected attribute spec, a policies.contract.PolicySpec; got none")
    policy: Policy = made
    return policy


def _is_plain(found: Any) -> bool:
    """Whether it is to be called with what is seen."""
    if inspect.isclass(found):
        return False
    try:
        parameters = inspect.signature(found).parameters
    except (TypeError, ValueError):
        return False
    return all(name in parameters for name in PARAMETERS)


def _check_options(found: Any, place: _Place) -> None:
    try:
        inspect.signature(found).bind(**dict.fromkeys(PARAMETERS), **place.options)
    except TypeError as error:
        raise PolicyError(f"policy '{place.text}': options do not fit the function: {error}") from None


def _named(error: BaseException) -> str:
    lines = str(error).strip().splitlines()
    return f"{type(error).__name__}: {lines[0] if lines else '(no message)'}"


def _files(options: Mapping[str, Any]) -> PolicyFiles:
    place = _Place(options)
    read = dict.fromkeys((*place.sources(), *place.files))
    # What is installed is expected on every node.
    return PolicyFiles({"folder": place.folder}, tuple(path for path in read if path.is_relative_to(place.folder)))


KIND = PolicyKind(
    name=NAME,
    summary="a Python class, factory or function",
    load=_load,
    digest=_digest,
    options={
        "callable": "module:Name of a class or factory of policies, or of a function of what is seen",
        "options": "what it is called with, by name",
        "folder": "folder that the module lies in, if it is not installed; by default the working directory",
        "files": "other files below the folder that it reads, such as weights: part of its content",
    },
    files=_files,
)
