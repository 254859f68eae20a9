"""Descriptions of policies from which any process on any node can build them.

On a cluster, Ray's object store carries the policies' files to nodes that lack them.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock

from robogauntlet.policies import catalog as policies
from robogauntlet.policies.contract import Policy, PolicyError, PolicyFiles
from robogauntlet.support.files import new_folder
from robogauntlet.support.private_folder import private_folder
from robogauntlet.support.secret_variables import variable_names


@dataclass(frozen=True)
class PolicyBundle:
    """Copies of a policy's files, for nodes that lack them."""

    options: Mapping[str, str]
    """Option to its path in the bundle."""
    files: Mapping[str, Callable[[], Any]]
    """Path in the bundle to a function that fetches the content (bytes-like)."""


@dataclass(frozen=True)
class PolicySource:
    """The kind and options of a policy, and the files that they refer to."""

    kind: str
    options: Mapping[str, Any] = field(default_factory=dict)
    digest: str | None = None
    """Expected hash of its content; None to accept any content."""
    bundle: PolicyBundle | None = None
    """Its files, for nodes that may lack them."""
    variables: Mapping[str, str] | None = field(default=None, repr=False, compare=False)
    """The environment variables that its option `variables` names, as they are where it is first described: processes
    that build it get no others of the user's."""

    def __post_init__(self) -> None:
        if self.variables is None:
            object.__setattr__(self, "variables", _variables(self.options))


def build_policy(source: PolicySource) -> Policy:
    """Build a policy.

    Raises:
        PolicyError: The policy cannot be built; see also `resolve_locally`.
    """
    local = resolve_locally(source)
    return policies.load(local.kind, local.options)


def resolve_locally(source: PolicySource) -> PolicySource:
    """Return a source that this node can read: the given one if its files match the digest, else one with copies.

    Copies are kept by digest in the system's folder for temporary files. A node fetches them once, and its processes
    share the memory that maps them.

    Raises:
        PolicyError: The files are missing or differ from the planned ones, and there is no bundle.
    """
    os.environ.update(source.variables or {})
    if source.digest is None:
        return source
    try:
        _check(source)
    except PolicyError:
        if source.bundle is None:
            raise
        folder = bundle_cache_dir(source.digest)
        options = {name: str(folder / path) for name, path in source.bundle.options.items()}
        copy = replace(source, options={**source.options, **options}, bundle=None)
        try:
            private_folder(folder.parent)  # another user's could exchange the files after they were checked
            with FileLock(f"{folder}.lock"):  # other processes of this node may fetch the same files
                try:
                    _check(copy)
                except PolicyError:  # not fetched yet, or partly deleted
                    shutil.rmtree(folder, ignore_errors=True)
                    _unpack(source.bundle, folder)
                    _check(copy)
        except OSError as error:
            raise PolicyError(f"the policy's files cannot be copied to {folder}: {error.strerror or error}") from None
        return copy
    return source


def with_bundles(sources: Mapping[str, PolicySource]) -> dict[str, PolicySource]:
    """Put the policies' files into Ray's object store and return sources with bundles. Ray must be running.

    A file that several policies read is stored once, for as long as a returned source exists.

    Raises:
        PolicyError: A policy's files cannot be read.
    """
    import ray

    stored: dict[Path, Callable[[], Any]] = {}
    bundled = {}
    for name, source in sources.items():
        bundled[name] = source
        files_of = policies.find(source.kind).files
        needed = files_of(source.options) if files_of else None
        if needed is None or not needed.files:
            continue
        options, files = bundle_layout(needed)
        for path in files.values():
            if path not in stored:
                stored[path] = partial(ray.get, ray.put(np.fromfile(path, dtype=np.uint8)))
        bundle = PolicyBundle(options, {place: stored[path] for place, path in files.items()})
        bundled[name] = replace(source, bundle=bundle)
    return bundled


def bundle_layout(files: PolicyFiles) -> tuple[dict[str, str], dict[str, Path]]:
    """Arrange a policy's files in a bundle: option to path in the bundle, and path in the bundle to file."""
    root = Path(os.path.commonpath([*files.files, *files.options.values()]))
    if root.is_file():
        root = root.parent
    options = {name: path.relative_to(root).as_posix() for name, path in files.options.items()}
    return options, {path.relative_to(root).as_posix(): path for path in files.files}


def bundle_cache_dir(digest: str) -> Path:
    """The folder in which a node keeps its copies of a policy's files."""
    return Path(tempfile.gettempdir()) / f"robogauntlet-{os.getuid()}" / digest


def given_variables(sources: Mapping[str, PolicySource]) -> Iterator[str]:
    """Yield a line for each policy that is given variables of the user's environment."""
    for name, source in sources.items():
        if source.variables:
            yield f"policy {name} gets the environment variables {', '.join(source.variables)}"


def _variables(options: Mapping[str, Any]) -> dict[str, str]:
    """The values of the variables that a policy's options name and that are set."""
    with contextlib.suppress(ValueError):  # the policy's kind says what is wrong with them
        names = variable_names(options.get("variables", ()))
        return {name: os.environ[name] for name in names if name in os.environ}
    return {}


def _check(source: PolicySource) -> None:
    digest = policies.digest(source.kind, source.options)
    if digest != source.digest:
        changed = f"policy '{source.kind}' has changed since the run was planned"
        raise PolicyError(f"{changed}: expected content {source.digest}, got {digest}")


def _unpack(bundle: PolicyBundle, folder: Path) -> None:
    """Write the bundle's files into a new folder, which appears when it is complete."""
    with new_folder(folder) as unfinished:
        for place, fetch in bundle.files.items():
            path = unfinished / place
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(fetch())
