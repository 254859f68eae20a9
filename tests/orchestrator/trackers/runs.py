"""Shared by the tests of trackers: a run to log, the verb, and a reader of W&B's files."""

import contextlib
import io
import json
import os
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from importlib.util import find_spec

import pytest

from robogauntlet.orchestrator.cli import main
from robogauntlet.results.run_document import Provenance, RunStatus
from robogauntlet.suites.episode import Condition
from tests.processes import run_gauntlet
from tests.results.synthetic import cells, document, row, run_folder

CONDITIONS = (Condition(), Condition("camera-position", 3))
SECRETS = {
    "reason": "could not reach postgresql://me:s3cr3t@host",
    "suite_text": "token: s3cr3t",
    "description": "s3cr3t",
    "suite_path": "/home/s3cr3t/suite.yaml",
    "store_url": None,
    "skipped": {"robosuite": "s3cr3t"},
}
"""Free text in a run's document."""


def save(folder, **changes):
    """A run in which p-1 solves 15 of 20 clean and 5 of 18 under a perturbation, with two errors, in two tasks."""
    own = cells(("p-1",), ("maniskill/PushCube-v1", "pybullet/Push"), CONDITIONS)
    rows = []
    for cell in own:
        solved = 15 if cell.condition == Condition() else 5
        broken = () if cell.condition == Condition() else (18, 19)
        for seed in range(20):
            status = "error" if seed in broken else "success" if seed < solved else "failure"
            rows.append(row(cell, seed, status))
    made = Provenance(git_commit="abc123", git_dirty=False, python="3.11.7", packages={"mani-skill": "3.0.1"})
    values = {"run_id": "f00d", "status": RunStatus.STOPPED, "provenance": made, **SECRETS}
    return run_folder(folder, document(20, own, **{**values, **changes}), rows)


def require(extra, *libraries):
    """Skip the tests of a module without these libraries, which are not imported: that takes seconds."""
    if not all(map(find_spec, libraries)):
        pytest.skip(f'not installed: pip install "robogauntlet[{extra}]"', allow_module_level=True)


@contextlib.contextmanager
def alone(cwd, variables):
    """In a folder, without settings of a tracker but these."""
    with pytest.MonkeyPatch.context() as patch:
        for name in [name for name in os.environ if name.startswith(("WANDB_", "MLFLOW_"))]:
            patch.delenv(name)
        for name, value in {"HOME": str(cwd), **variables}.items():
            patch.setenv(name, value)
        patch.chdir(cwd)
        yield patch


def gauntlet_log(*arguments, cwd, without=(), **environment):
    """`robogauntlet export --tracker`, in this process, as if the libraries `without` were not installed."""
    output, errors, code = io.StringIO(), io.StringIO(), 0
    with alone(cwd, environment) as patch, redirect_stdout(output), redirect_stderr(errors):
        for name in [*without, *(name for name in sys.modules if name.partition(".")[0] in without)]:
            patch.setitem(sys.modules, name, None)
        patch.setattr(sys, "argv", ["robogauntlet", "export", *arguments])
        try:
            main()
        except SystemExit as end:
            code = end.code or 0
    return subprocess.CompletedProcess(arguments, code, output.getvalue(), errors.getvalue())


def gauntlet_log_apart(*arguments, cwd, **environment):
    """`robogauntlet export --tracker`, in a new process: W&B keeps the settings with which it was first used in one."""
    with alone(cwd, environment):
        return run_gauntlet("export", *arguments, cwd=cwd)


def wandb_records(path):
    """The records of a `.wandb` file: LevelDB's log format, each a protobuf."""
    from wandb.proto import wandb_internal_pb2 as proto

    data, at, size, parts = path.read_bytes(), 7, 32768, b""
    while at + 7 <= len(data):
        if size - at % size < 7:  # the rest of a block that has no room for a record's header
            at += size - at % size
            continue
        length, kind = int.from_bytes(data[at + 4 : at + 6], "little"), data[at + 6]
        parts += data[at + 7 : at + 7 + length]
        at += 7 + length
        if kind in (1, 4):  # whole, or the last part
            record = proto.Record()
            record.ParseFromString(parts)
            yield record
            parts = b""


def items(them):
    """Keys and values of W&B's items."""
    return {one.key or "/".join(one.nested_key): json.loads(one.value_json) for one in them}
