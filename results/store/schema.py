"""The tables of a store: runs, the counts of their cells, and their episodes.

A store holds one run (in its folder) or many. A run's document and counts (`runs`, `cells`) may be in one
store and its rows (`episodes`) in another, which `folder` or `rows_url` names.
"""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa

from robogauntlet.results.record import CELL, describe_fields
from robogauntlet.results.store.database import Schema

VERSION, OLDEST = 2, 1
"""Version 2 has columns of `episodes` that are empty in rows of version 1, see `record.WAITING`."""
_TYPES: dict[type, Any] = {str: sa.Text, int: sa.BigInteger, float: sa.Float(53), bool: sa.Boolean}

metadata = sa.MetaData()
_version = sa.Table("robogauntlet_schema", metadata, sa.Column("version", sa.Integer, primary_key=True))
runs = sa.Table(
    "runs",
    metadata,
    sa.Column("run_id", sa.Text, primary_key=True),
    sa.Column("started_at", sa.Float(53), nullable=False),
    sa.Column("document", sa.Text, nullable=False),  # `RunDocument` as JSON
    sa.Column("suite", sa.Text, nullable=False),
    sa.Column("status", sa.Text, nullable=False),
    sa.Column("finished_at", sa.Float(53)),
    sa.Column("planned", sa.BigInteger, nullable=False),
    sa.Column("folder", sa.Text),  # with its report, and its rows if `rows_url` is null
    sa.Column("rows_url", sa.Text),  # without password; null: `episodes.sqlite` in the folder, or this store
    sa.Column("verdict", sa.Text),  # of the comparison with `baseline`
    sa.Column("baseline", sa.Text),
    sa.Column("reasons", sa.Text),  # for the verdict, a line each
    sa.Column("accepted", sa.Boolean),  # a person accepted it as the baseline of later runs
    sa.Column("schedule", sa.Text),  # that started it
    sa.Column("live", sa.Text),  # `LiveStatus` as JSON, while it runs
)
cells = sa.Table(
    "cells",
    metadata,
    sa.Column("run_id", sa.Text, sa.ForeignKey("runs.run_id", ondelete="CASCADE"), primary_key=True),
    sa.Column("policy", sa.Text, nullable=False),
    sa.Column("policy_digest", sa.Text, primary_key=True),
    sa.Column("task", sa.Text, primary_key=True),
    sa.Column("axis", sa.Text, primary_key=True),
    sa.Column("severity", sa.BigInteger, primary_key=True),
    sa.Column("planned", sa.BigInteger, nullable=False),
    sa.Column("successes", sa.BigInteger, nullable=False),
    sa.Column("failures", sa.BigInteger, nullable=False),
    sa.Column("errors", sa.BigInteger, nullable=False),
)
episodes = sa.Table(
    "episodes",
    metadata,
    sa.Column("run_id", sa.Text, sa.ForeignKey("runs.run_id"), primary_key=True),
    *(
        sa.Column(name, _TYPES[kind], primary_key=name == "episode_id", nullable=nullable)
        for name, (kind, nullable, _) in describe_fields().items()
    ),
)
imported_runs = sa.Table("imported_runs", metadata, sa.Column("run_id", sa.Text, primary_key=True))
"""Runs whose document has the origin `imported`."""
forgotten_runs = sa.Table(
    "forgotten_runs",
    metadata,
    sa.Column("run_id", sa.Text, primary_key=True),
    sa.Column("folder", sa.Text),  # which is not recorded again when folders are scanned
)
what_is_there = sa.Index(
    "robogauntlet_what_is_there",
    *(episodes.c[name] for name in ("run_id", "policy_digest", "task", "axis", "severity", "seed", "status")),
)
"""Finds the missing episodes of a run without reading its rows."""
_by_suite = sa.Index("robogauntlet_runs_by_suite", runs.c.suite, runs.c.started_at)
_by_time = sa.Index("robogauntlet_runs_by_time", runs.c.started_at)
_by_status = sa.Index("robogauntlet_runs_by_status", runs.c.status, runs.c.started_at)
_judged = sa.Index(
    "robogauntlet_runs_judged", *(runs.c.started_at, runs.c.suite), sqlite_where=runs.c.verdict.is_not(None)
)
"""Finds the latest verdicts without reading documents."""
_by_policy = sa.Index("robogauntlet_cells_by_policy", cells.c.policy, cells.c.run_id)


def counted_cells() -> sa.Select[Any]:
    """Counts of each cell of each run, from the episodes: run, `CELL`, successes, failures, errors."""
    e = episodes.c
    key = (e.run_id, *(e[name] for name in CELL))

    def number(status: str, name: str) -> sa.Label[Any]:
        return sa.func.sum(sa.case((e.status == status, 1), else_=0)).label(name)

    counts = (number("success", "successes"), number("failure", "failures"), number("error", "errors"))
    return sa.select(*key, *counts).group_by(*key)


SCHEMA = Schema(metadata, _version, VERSION, "store", OLDEST)
