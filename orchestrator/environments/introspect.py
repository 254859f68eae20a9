"""Run by the Python of another environment, of any version: reports what is installed. Standard library only."""

import json
import os
import sys
from importlib import metadata, util


def _version(distribution):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return None


def _file(module):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    spec = util.find_spec(module)
    if spec is None:
        return None
    return os.path.realpath(spec.origin) if spec.origin else ""


def _answer():  # type: ignore[no-untyped-def]  # noqa: ANN202
    request = json.loads(sys.stdin.readline())
    answer = {
        "python": ".".join(map(str, sys.version_info[:3])),
        "modules": {name: _file(name) for name in request["modules"]},
        "versions": {name: _version(name) for name in request["distributions"]},
    }
    with os.fdopen(int(sys.argv[-1]), "w") as answers:  # see robogauntlet.support.child_process
        answers.write(json.dumps(answer) + "\n")


if __name__ == "__main__":
    _answer()
