"""Files that ManiSkill's wheel lacks, in a folder of the user's, laid out as ManiSkill's own downloads are.

It is `ROBOGAUNTLET_MANISKILL_ASSETS`, else ManiSkill's `MS_ASSET_DIR`, else `~/.maniskill`. Nothing is downloaded.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from robogauntlet.adapters.contract import TaskUnavailable
from robogauntlet.adapters.user_assets import content_hash, named_folder, variable, what_lacks
from robogauntlet.support.errors import first_line
from robogauntlet.support.json_text import parse_json

OWN_VARIABLE = "MS_ASSET_DIR"
YCB = "data/assets/mani_skill2_ycb"
YCB_INFO = f"{YCB}/info_pick_v0.json"
NEEDS = {"PickSingleYCB-v1@Panda-joint-delta": YCB}
"""Task to the part of the folder that it needs."""


def assets_folder() -> Path:
    """Return the folder, which need not exist."""
    default = Path(os.environ.get(OWN_VARIABLE) or Path.home() / ".maniskill")
    return named_folder("maniskill") or default


def use_folder() -> None:
    """Tell ManiSkill the folder, before its first import."""
    os.environ[OWN_VARIABLE] = str(assets_folder())


def check_assets(task: str) -> None:
    """Raise TaskUnavailable if a task's files are missing, in whole or in part."""
    if task not in NEEDS:
        return
    folder = assets_folder()
    if lacks := what_lacks(folder, [YCB_INFO]) or what_lacks(folder, _models(folder)):
        raise TaskUnavailable(f"it needs ManiSkill's files of the YCB objects: {lacks}; see {variable('maniskill')}")


def described(device: str) -> str:
    """Return a device with the hash of those of the folder's files that a task here needs, if there are any."""
    folder = assets_folder()
    parts = tuple(part for part in dict.fromkeys(NEEDS.values()) if (folder / part).is_dir())
    return f"{device}, assets {content_hash(folder, parts)}" if parts else device


def _models(folder: Path) -> Iterator[str]:
    """Yield the files of all objects of which an episode may draw one."""
    try:
        names = list(parse_json((folder / YCB_INFO).read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError) as error:
        why = first_line(error)
        raise TaskUnavailable(f"expected ManiSkill's list of objects in {folder / YCB_INFO}, got: {why}") from None
    for name in names:
        yield from (f"{YCB}/models/{name}/{file}" for file in ("collision.ply", "textured.obj"))
