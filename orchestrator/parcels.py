"""Policies' files in Ray's object store, where every node of a cluster can fetch them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import ray

from orchestrator.sources import Parcel, PolicySource, laid_out
from policies import catalog


@dataclass(frozen=True)
class _Stored:
    """A file's bytes in the object store; called, it fetches them."""

    reference: Any

    def __call__(self) -> Any:
        return ray.get(self.reference)


def with_parcels(sources: Mapping[str, PolicySource]) -> dict[str, PolicySource]:
    """The sources, with a parcel for those that read files. Ray must be running.

    A file that several policies read is stored once, and for as long as somebody holds what is returned.

    Raises:
        PolicyError: A policy's files cannot be read.
    """
    stored: dict[Path, _Stored] = {}
    return {name: _with_parcel(source, stored) for name, source in sources.items()}


def _with_parcel(source: PolicySource, stored: dict[Path, _Stored]) -> PolicySource:
    files_of = catalog.find(source.kind).files
    if files_of is None:
        return source
    options, files = laid_out(files_of(source.options))
    for path in files.values():
        if path not in stored:
            stored[path] = _Stored(ray.put(np.fromfile(path, dtype=np.uint8)))
    return replace(source, parcel=Parcel(options, {name: stored[path] for name, path in files.items()}))
