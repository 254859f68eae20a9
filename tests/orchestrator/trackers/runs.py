"""Shared by the tests of trackers: a run to log, the verb, and a reader of W&B's files."""

import json
import os
import sys

import pytest

from robogauntlet.results.run_document import Provenance, RunStatus
from robogauntlet.suites.episode import Condition
from tests.processes import run_process
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


def gauntlet_log(*arguments, cwd, without=(), **environment):
    """`robogauntlet log`, in a new process, as if the libraries `without` were not installed."""
    code = (
        f"import sys; sys.modules.update(dict.fromkeys({list(without)}))\n"
        "from robogauntlet.orchestrator.cli import app, main\nfrom robogauntlet.orchestrator.cli.log import log\n"
        "app.command('log')(log)\nmain()"
    )
    with pytest.MonkeyPatch.context() as patch:
        for name in [name for name in os.environ if name.startswith(("WANDB_", "MLFLOW_"))]:
            patch.delenv(name)
        return run_process([sys.executable, "-c", code, "log", *arguments], cwd, HOME=str(cwd), **environment)


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
