"""Run by the Python of another environment, of whatever version: says what is in there. Imports Python's own only."""

import json
import os
import sys
from importlib import metadata, util

MARK = "robogauntlet-inside:"


def _version(distribution):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return None


def _place(module):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    found = util.find_spec(module)
    if found is None:
        return None
    return os.path.realpath(found.origin) if found.origin else ""  # noqa: PTH


def _say():  # type: ignore[no-untyped-def]  # noqa: ANN202
    asked = json.loads(sys.argv[1])
    found = {
        "python": ".".join(map(str, sys.version_info[:3])),
        "modules": {name: _place(name) for name in asked["modules"]},
        "versions": {name: _version(name) for name in asked["distributions"]},
    }
    print(MARK + json.dumps(found))


if __name__ == "__main__":
    _say()
