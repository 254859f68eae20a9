"""Objects that LIBERO-Plus adds to LIBERO's scenes, from assets of the user's. Its code is read as text.

All of its classes are one with another file: `CustomObjects` of `envs/objects/custom_objects.py`. What that turns an
object by where it is placed is not needed, since the stored states say it.
"""

from __future__ import annotations

import copy
import importlib
import re
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from robogauntlet.adapters.libero_plus.task_files import plus_folder

NAMED = re.compile(r'^class (\w+)\(CustomObjects\):.*?"assets/([^"]+\.xml)"', re.MULTILINE | re.DOTALL)
FREE = {"type": "free", "damping": "0.0005"}


@cache
def object_files() -> Mapping[str, str]:
    """Return the file within the assets by kind of object; none if LIBERO-Plus is not installed."""
    folder = plus_folder()
    path = folder and folder / "envs" / "objects" / "custom_objects.py"
    if path is None or not path.is_file():
        return {}
    return {kind_of(name): file for name, file in NAMED.findall(path.read_text(encoding="utf-8"))}


def kind_of(name: str) -> str:
    """Return the name in task files of the objects of a class: `WhiteBowl`, `white_bowl`."""
    parts = ("_" + letter.lower() if letter.isupper() or letter.isdecimal() else letter for letter in name)
    return "".join(parts).removeprefix("_")


def register(kinds: Iterable[str], assets: Path) -> None:
    """Tell LIBERO, which is imported, these kinds of objects."""
    known = importlib.import_module("libero.libero.envs.base_object").OBJECTS_DICT
    for kind in kinds:
        known[kind] = _class_of(kind, assets / object_files()[kind])


def _class_of(kind: str, path: Path) -> type:
    from robosuite.models.objects import MujocoXMLObject

    class Added(MujocoXMLObject):
        def __init__(self, name: str = kind, obj_name: str = kind) -> None:
            options = {"joints": [dict(FREE)], "obj_type": "all", "duplicate_collision_geoms": False}
            super().__init__(str(path), name=name, **options)
            self.category_name = kind
            self.rotation, self.rotation_axis = (0.0, 0.0), "x"
            self.object_properties: dict[str, Any] = {"vis_site_names": {}}

        def _get_object_subtree(self) -> Any:
            """Accept an object without the body around it in which robosuite looks for it, as LIBERO-Plus does."""
            if (bare := self.worldbody.find("./body[@name='object']")) is not None:
                around = ElementTree.Element("body")
                around.extend([bare, *map(copy.deepcopy, bare.findall("./site"))])
                self.worldbody.remove(bare)
                self.worldbody.append(around)
            return super()._get_object_subtree()

    return Added
