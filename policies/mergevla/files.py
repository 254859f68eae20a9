"""Which files checkpoints consist of, so that a copy of them can be made elsewhere."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from policies.mergevla.card import CARD, WEIGHTS, card_json, locate


def checkpoint_files(reference: str | Path) -> tuple[Path, tuple[Path, ...]]:
    """A checkpoint's folder, and its files with those of the base beside it. A base on a hub stays there.

    Raises:
        PolicyError: There is no such checkpoint.
    """
    folder = locate(str(reference)).resolve()
    folders = [folder]
    base = card_json(folder).get("base")
    if isinstance(base, str) and (folder / base).is_dir():
        folders.append((folder / base).resolve())
    return folder, tuple(place / name for place in folders for name in (CARD, WEIGHTS))


def all_files(references: Iterable[str | Path]) -> tuple[Path, ...]:
    """The files of several checkpoints, each once.

    Raises:
        PolicyError: One of them is none.
    """
    return tuple(dict.fromkeys(file for reference in references for file in checkpoint_files(reference)[1]))
