"""The tables of a store: runs, what came of their cells, their episodes. How older stores become this one.

A store holds the runs of a folder, of a group, or one run alone: they are the same tables. What a run was and came to
(`runs`, `cells`) may be in one store and its rows (`episodes`) in another, which `folder` or `rows_url` names.
"""

from __future__ import annotations

import json
from typing import Any

import sqlalchemy as sa

from results.database import Schema
from results.record import describe_fields

VERSION = 5
_TYPES: dict[type, Any] = {str: sa.Text, int: sa.BigInteger, float: sa.Float(53), bool: sa.Boolean}

metadata = sa.MetaData()
_version = sa.Table("robogauntlet_schema", metadata, sa.Column("version", sa.Integer, primary_key=True))
runs = sa.Table(
    "runs",
    metadata,
    sa.Column("run_id", sa.Text, primary_key=True),
    sa.Column("started_at", sa.Float(53), nullable=False),
    sa.Column("document", sa.Text, nullable=False),  # `RunDocument` as JSON, or less of it in migrated stores
    sa.Column("suite", sa.Text),
    sa.Column("status", sa.Text),
    sa.Column("finished_at", sa.Float(53)),
    sa.Column("planned", sa.BigInteger),
    sa.Column("folder", sa.Text),  # where its report lies, and its rows if `rows_url` is null
    sa.Column("rows_url", sa.Text),  # without password; null: `episodes.sqlite` in the folder, or this store
    sa.Column("verdict", sa.Text),  # of the comparison with `baseline`
    sa.Column("baseline", sa.Text),
    sa.Column("reasons", sa.Text),  # of the verdict, a line each
    sa.Column("accepted", sa.Boolean),  # a person said that this is what later runs are held against
    sa.Column("schedule", sa.Text),  # the schedule that began it, if one did
    sa.Column("live", sa.Text),  # `results.live.Live` as JSON, while it runs
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
what_is_there = sa.Index(
    "robogauntlet_what_is_there",
    *(episodes.c[name] for name in ("run_id", "policy_digest", "task", "axis", "severity", "seed", "status")),
)
"""Answers what a run still lacks without reading its rows."""
_by_suite = sa.Index("robogauntlet_runs_by_suite", runs.c.suite, runs.c.started_at)
_by_time = sa.Index("robogauntlet_runs_by_time", runs.c.started_at)
_by_status = sa.Index("robogauntlet_runs_by_status", runs.c.status, runs.c.started_at)
_judged = sa.Index(
    "robogauntlet_runs_judged",
    *(runs.c.started_at, runs.c.suite),
    sqlite_where=runs.c.verdict.is_not(None),
    postgresql_where=runs.c.verdict.is_not(None),
)
"""Finds what was judged last without reading documents."""
_by_policy = sa.Index("robogauntlet_cells_by_policy", cells.c.policy, cells.c.run_id)


def _add_columns(connection: sa.Connection, table: sa.Table, *names: str) -> None:
    for name in names:
        column = table.c[name]
        kind = column.type.compile(connection.dialect)
        default = "" if column.nullable else " NOT NULL DEFAULT 0"
        connection.exec_driver_sql(f"ALTER TABLE {table.name} ADD COLUMN {name} {kind}{default}")


def _routing(connection: sa.Connection) -> None:
    _add_columns(connection, episodes, "unknown_score", "rejected", "routing_s")


def _perturbations(connection: sa.Connection) -> None:
    _add_columns(connection, episodes, "delivered", "delivered_statistics")


def _history(connection: sa.Connection) -> None:
    """Runs with what they came to. What a run was is known by its name only: the rest stood in its folder."""
    there = ("run_id", "started_at", "document")
    _add_columns(connection, runs, *(column.name for column in runs.c if column.name not in there))
    connection.execute(sa.schema.CreateTable(cells, if_not_exists=True))
    for index in (*runs.indexes, *cells.indexes, *episodes.indexes):
        connection.execute(sa.schema.CreateIndex(index, if_not_exists=True))
    for run_id, text in connection.execute(sa.select(runs.c.run_id, runs.c.document)).all():
        suite = json.loads(text).get("suite")
        connection.execute(sa.update(runs).where(runs.c.run_id == run_id).values(suite=suite))
    columns = [*counted_cells().selected_columns]
    name, planned = sa.func.min(episodes.c.policy).label("policy"), sa.func.count().label("planned")
    count = counted_cells().add_columns(name, planned)
    connection.execute(sa.insert(cells).from_select([*(c.name for c in columns), name.name, planned.name], count))


def _queries(connection: sa.Connection) -> None:
    """How long single queries took; what older rows took is not known."""
    _add_columns(connection, episodes, "query_p50_s", "query_p95_s", "query_max_s")


CELL = ("policy_digest", "task", "axis", "severity")
"""What makes a cell of a run. The digest, not the name: a policy that was renamed has kept its episodes."""


def counted_cells() -> sa.Select[Any]:
    """What came of each cell of each run, from the episodes: run, `CELL`, successes, failures, errors."""
    e = episodes.c
    key = (e.run_id, *(e[name] for name in CELL))

    def number(status: str, name: str) -> sa.Label[Any]:
        return sa.func.sum(sa.case((e.status == status, 1), else_=0)).label(name)

    counts = (number("success", "successes"), number("failure", "failures"), number("error", "errors"))
    return sa.select(*key, *counts).group_by(*key)


SCHEMA = Schema(metadata, _version, VERSION, {1: _routing, 2: _perturbations, 3: _history, 4: _queries}, "store")
