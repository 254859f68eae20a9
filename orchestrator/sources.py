"""From what policies are built, in whatever process and on whatever node."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from filelock import FileLock

from policies import catalog as policies
from policies.contract import Policy, PolicyError, PolicyFiles

PRIVATE = 0o700


@dataclass(frozen=True)
class Parcel:
    """Copies of a policy's files, for nodes that lack them."""

    options: Mapping[str, str]
    """Option to the path in the parcel that it stands for."""
    files: Mapping[str, Callable[[], Any]]
    """Path in the parcel to what fetches the content (bytes, or the like)."""


@dataclass(frozen=True)
class PolicySource:
    """From what a policy is built."""

    kind: str
    options: Mapping[str, Any] = field(default_factory=dict)
    digest: str | None = None
    """Of its content as it was planned; None to take what is there."""
    parcel: Parcel | None = None
    """Its files, if it may be wanted where they are not."""


def build(source: PolicySource) -> Policy:
    """The policy itself.

    Raises:
        PolicyError: See `here`; or it cannot be built.
    """
    found = here(source)
    return policies.load(found.kind, found.options)


def here(source: PolicySource) -> PolicySource:
    """The source as this node can read it: its own files if they are what was planned, else copies of the planned ones.

    Copies are kept below the system's folder for temporary files, by digest: a node fetches them once, and its
    processes share the memory that maps them.

    Raises:
        PolicyError: The files were changed, or are others on this node, or are missing, and there is no parcel.
    """
    if source.digest is None:
        return source
    try:
        _check(source)
    except PolicyError:
        if source.parcel is None:
            raise
        folder = copies(source.digest)
        options = {name: str(folder / path) for name, path in source.parcel.options.items()}
        copy = replace(source, options={**source.options, **options}, parcel=None)
        with _alone_with(folder):
            try:
                _check(copy)
            except PolicyError:  # not fetched yet, or cleared away in part
                shutil.rmtree(folder, ignore_errors=True)
                _unpack(source.parcel, folder)
                _check(copy)
        return copy
    return source


def laid_out(own: PolicyFiles) -> tuple[dict[str, str], dict[str, Path]]:
    """How files lie in a parcel: option to its path there, and path there to the file."""
    root = Path(os.path.commonpath([*own.files, *own.options.values()]))
    if root.is_file():
        root = root.parent
    options = {name: path.relative_to(root).as_posix() for name, path in own.options.items()}
    return options, {path.relative_to(root).as_posix(): path for path in own.files}


def copies(digest: str) -> Path:
    """Where a node keeps the copies of a policy's files."""
    return Path(tempfile.gettempdir()) / f"robogauntlet-{os.getuid()}" / digest


def _check(source: PolicySource) -> None:
    if (found := policies.digest(source.kind, source.options)) != source.digest:
        raise PolicyError(
            f"policy '{source.kind}' has changed since the run was planned: "
            f"expected content {source.digest}, got {found}"
        )


@contextlib.contextmanager
def _alone_with(folder: Path) -> Iterator[None]:
    """Keep this node's other processes from fetching the same; raises PolicyError."""
    try:
        folder.parent.mkdir(mode=PRIVATE, exist_ok=True)
        lock = FileLock(f"{folder}.lock")
        lock.acquire()
    except OSError as error:
        raise _no_copy(folder, error) from None
    try:
        yield
    finally:
        lock.release()


def _no_copy(folder: Path, error: OSError) -> PolicyError:
    return PolicyError(f"the policy's files cannot be copied to {folder}: {error.strerror}")


def _unpack(parcel: Parcel, folder: Path) -> None:
    """Write the parcel's files into a folder, complete under its name or not there."""
    try:
        with tempfile.TemporaryDirectory(prefix=f"{folder.name}.partial-", dir=folder.parent) as name:
            partial = Path(name) / "files"
            for place, fetch in parcel.files.items():
                path = partial / place
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(fetch())
            partial.rename(folder)
    except OSError as error:
        raise _no_copy(folder, error) from None
