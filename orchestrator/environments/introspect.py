"""Run by the Python of another environment, of any version: reports what is installed. Standard library only."""

import base64
import hashlib
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


def _differing(distribution):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Return the installed files that are missing, or are not those that the wheel's RECORD has the hashes of."""
    try:
        files = metadata.files(distribution) or []
    except metadata.PackageNotFoundError:
        return []
    differing = []
    for file in files:
        if file.suffix == ".pyc" or file.hash is None or file.hash.mode not in hashlib.algorithms_available:
            continue
        try:
            digest = hashlib.new(file.hash.mode, file.read_binary()).digest()
        except OSError:
            digest = b""
        if base64.urlsafe_b64encode(digest).rstrip(b"=").decode() != file.hash.value:
            differing.append(str(file))
    return differing


def _answer():  # type: ignore[no-untyped-def]  # noqa: ANN202
    request = json.loads(sys.stdin.readline())
    answer = {
        "python": ".".join(map(str, sys.version_info[:3])),
        "modules": {name: _file(name) for name in request["modules"]},
        "versions": {name: _version(name) for name in request["distributions"]},
        "differing": {name: _differing(name) for name in request["compared"]},
    }
    with os.fdopen(int(sys.argv[-1]), "w") as answers:  # see robogauntlet.support.child_process
        answers.write(json.dumps(answer) + "\n")


if __name__ == "__main__":
    _answer()
