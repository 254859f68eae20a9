"""Any Python class, factory or function as a policy.

It is found by name and identified by the hash of its source; `robogauntlet.policies.function_policy` makes the policy.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from robogauntlet.policies.contract import Policy, PolicyError, PolicyFiles, PolicyKind
from robogauntlet.policies.function_policy import as_policy
from robogauntlet.suites.episode import content_hash
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.support.errors import describe
from robogauntlet.support.files import open_regular, read_regular
from robogauntlet.support.secret_variables import variable_names

NAME = "python"
MAX_SOURCES = 1000
"""Largest number of a package's files that are hashed."""


class _Place:
    """A callable named by a suite's options: module, name, folder and further files. Raises PolicyError."""

    def __init__(self, options: Mapping[str, Any]) -> None:
        text = options.get("callable")
        expected = f"policy '{NAME}': expected python:MODULE:NAME, or option callable: MODULE:NAME"
        if not isinstance(text, str):
            raise PolicyError(f"{expected}, got {text!r}")
        self.text = text
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
        try:
            variable_names(options.get("variables", ()))
        except ValueError as error:
            raise PolicyError(f"policy '{NAME}': option variables: {error}") from None

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
            file = self.module.removesuffix(".py")
            is_file = file != self.module and self.folder.joinpath(f"{file}.py").is_file()
            remedy = f"write {file}:{self.name}, without .py" if is_file else "give its folder by option folder"
            raise PolicyError(
                f"policy '{self.text}': expected a module '{self.module}' in '{self.folder}' or installed, found none; "
                f"{remedy}"
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
    if text:
        return hashlib.sha256(b"\n".join(read_regular(path).splitlines())).hexdigest()
    with open_regular(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _import(place: _Place) -> Any:
    """Import the callable."""
    origin, top = place.origin, place.module.partition(".")[0]
    added = origin.is_relative_to(place.folder) and str(place.folder) not in sys.path
    if added:
        sys.path.append(str(place.folder))  # last, so that its modules hide no others
    importlib.invalidate_caches()
    try:
        module = importlib.import_module(place.module)
    except BaseException as error:
        if added:
            sys.path.remove(str(place.folder))  # it would hide another module of this name
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
            raise PolicyError(f"policy '{place.text}': {place.module} has no '{part}'{did_you_mean(part, names)}")
        target = getattr(target, part)
    if not callable(target):
        raise PolicyError(f"policy '{place.text}': expected a class or a function, got {type(target).__name__}")
    return target


def _load(options: Mapping[str, Any]) -> Policy:
    place = _Place(options)
    return as_policy(_import(place), place.options, place.text)


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
    digest_without_start=_digest,
    imports_code=True,
    options={
        "callable": "module:Name of a class or factory of policies, or of a function of the observation",
        "options": "its keyword arguments",
        "folder": "folder of the module if it is not installed; by default the working directory",
        "files": "other files below the folder that it reads, such as weights; they count for its digest",
        "variables": "environment variables that it needs, such as [WANDB_API_KEY]; it gets no other secret",
    },
    files=_files,
)
