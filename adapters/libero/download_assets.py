"""Lets LIBERO download its assets: `python -m robogauntlet.adapters.libero.download_assets`."""

from __future__ import annotations

import importlib

from robogauntlet.adapters.contract import SimulatorUnavailable
from robogauntlet.adapters.libero.assets import find_assets
from robogauntlet.adapters.libero.libero_import import import_libero, silenced


def _main() -> None:
    try:
        import_libero()
        with silenced():
            importlib.import_module("libero.libero.utils.download_utils").download_assets_from_huggingface()
        assets = find_assets()
    except (SimulatorUnavailable, OSError, ImportError) as error:
        raise SystemExit(str(error)) from None
    print(f"{assets}, in {assets.folder}")


if __name__ == "__main__":
    _main()
