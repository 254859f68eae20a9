"""Run by the Python of another environment, of any version: reports what is installed. Standard library only."""

import base64
import csv
import hashlib
import json
import os
import sys
from importlib import import_module, metadata, util

HASHES = ("sha256", "sha384", "sha512")


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


def _import_problem(target):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Import a module, or call `MODULE:FUNCTION`, and return the error in one line, or None."""
    module, _, function = target.partition(":")
    try:
        imported = import_module(module)
        if function:
            getattr(imported, function)()
    except Exception as error:  # an import can raise anything
        lines = str(error).strip().splitlines() or ["no message"]
        return f"{type(error).__name__}: {lines[0]}"
    return None


def _differing(name):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Return the installed files that are missing, or are not those that the wheel's RECORD has the hashes of."""
    try:
        distribution = metadata.distribution(name)
    except metadata.PackageNotFoundError:
        return []
    differing = []
    # `distribution.files` leaves out missing files from Python 3.12 on.
    for path, *stated in csv.reader((distribution.read_text("RECORD") or "").splitlines()):
        mode, _, value = "".join(stated[:1]).partition("=")
        if path.endswith(".pyc") or mode not in HASHES:
            continue
        try:
            with open(str(distribution.locate_file(path)), "rb") as file:  # noqa: PTH123
                digest = hashlib.new(mode, file.read()).digest()
        except OSError:
            digest = b""
        if base64.urlsafe_b64encode(digest).rstrip(b"=").decode() != value:
            differing.append(path)
    return differing


def _answer():  # type: ignore[no-untyped-def]  # noqa: ANN202
    request = json.loads(sys.stdin.readline())
    answer = {
        "python": ".".join(map(str, sys.version_info[:3])),
        "modules": {name: _file(name) for name in request["modules"]},
        "versions": {name: _version(name) for name in request["distributions"]},
        "imports": [problem for problem in map(_import_problem, request["imports"]) if problem is not None],
        "differing": {name: _differing(name) for name in request["compared"]},
    }
    with os.fdopen(int(sys.argv[-1]), "w") as answers:  # see robogauntlet.support.child_process
        answers.write(json.dumps(answer) + "\n")


if __name__ == "__main__":
    _answer()
