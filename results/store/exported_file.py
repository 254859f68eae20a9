"""Reads an exported run from an untrusted source as data: the file's tables and nothing else, every value checked.

The sender's SQLite file is opened read-only. Before any row is read, its schema has to be ours to the letter, so that
no view, trigger, generated column or virtual table of the sender's is evaluated. Lengths and time are limited. Where
SQLite itself may fail, `limited_reader` reads in a process of its own.
"""

from __future__ import annotations

import math
import re
import sqlite3
import time
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy.dialects import sqlite

from robogauntlet.results.record import FIELDS, EpisodeResult, FailureKind, Status, describe_fields, has_behaviour
from robogauntlet.results.run_document import MAX_COUNT, RunDocument, RunError, RunStatus, parse_run
from robogauntlet.results.store.schema import SCHEMA, columns_after, episodes, forgotten_runs, imported_runs
from robogauntlet.results.store.sqlite_file import why_no_database
from robogauntlet.suites.episode import ProtocolName, RenderProfile
from robogauntlet.suites.ranges import MAX_STEPS
from robogauntlet.support.json_text import parse_json

LONGEST_VALUE = 16 * 2**20
"""Largest length of a value in the file, such as the run's document (bytes)."""
LONGEST_TEXT = 100_000
"""Largest length of a text in a row (characters)."""
MIN_TIME_S, BYTES_PER_S = 60.0, 1_000_000
"""Time for reading: the former (s), and a second for as many bytes of the file."""
RUN_ID = re.compile("[0-9a-f]{32}")
_TYPES: dict[type, frozenset[type]] = {
    str: frozenset({str}),
    int: frozenset({int}),
    bool: frozenset({int}),
    float: frozenset({float}),
}
_BOUNDS = {
    **dict.fromkeys(("path_length", "time_to_success", "contact_force"), (0.0, math.inf)),
    **{"smoothness": (-math.inf, 0.0), "progress": (-1.0, 1.0)},
}
_STEPS = ("gripper_openings", "contact_steps", "joint_limit_steps", "workspace_steps")
"""Counts of which a control step adds at most one."""


class ExportedRun:
    """An exported run whose schema and document were checked. Its rows are checked as they are read."""

    def __init__(self, file: Path, size: int, connection: sqlite3.Connection) -> None:
        """See `open_exported`."""
        self._file, self._size, self._connection = file, size, connection
        self._missing = columns_after(_check_schema(file, connection))
        self.document = _read_document(file, connection)

    def rows(self) -> Iterator[EpisodeResult]:
        """Yield all rows. Raises RunError for one that this program has not written for this run."""
        check, left = _RowCheck(self.document), self._size
        names = ", ".join("NULL" if name in self._missing else name for name in FIELDS)
        with explained(self._file):
            # Not through an index, which may tell something else than the table.
            for run_id, *values in self._connection.execute(f"SELECT run_id, {names} FROM episodes NOT INDEXED"):
                if run_id != self.document.run_id:
                    raise RunError(f"{self._file}: expected rows of one run, got rows of several")
                if fault := check.fault(values):
                    raise RunError(f"{self._file}: a row is not one of this program: {fault}")
                left -= check.length
                if left < 0:  # a page of the file is used many times
                    raise RunError(f"{self._file}: expected an exported run, its rows are larger than the file")
                yield check.result


def exported_size(file: Path) -> int:
    """Return the size of what may be an exported run (bytes), without opening it. Raises RunError if it cannot be."""
    if reason := why_no_database(file, create=False):
        raise RunError(f"{file}: expected an exported run (`robogauntlet export`), {reason}")
    try:
        return file.stat().st_size
    except (OSError, ValueError) as error:
        raise RunError(f"{file}: expected an exported run: {getattr(error, 'strerror', error)}") from None


def reading_time_s(size: int) -> float:
    """Return the time that an exported run of this many bytes may take (s)."""
    return MIN_TIME_S + size / BYTES_PER_S


@contextmanager
def open_exported(file: Path) -> Iterator[ExportedRun]:
    """Open an exported run during the block.

    Raises:
        RunError: It is not an exported run, or one of another version that is not upgraded.
    """
    size = exported_size(file)
    with explained(file):
        connection = sqlite3.connect(f"{file.absolute().as_uri()}?mode=ro&immutable=1", uri=True, isolation_level=None)
    with closing(connection):
        deadline = time.monotonic() + reading_time_s(size)
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LONGEST_VALUE)
        connection.set_progress_handler(lambda: time.monotonic() > deadline, 10_000)
        with explained(file):
            connection.execute("PRAGMA trusted_schema=OFF")
            connection.execute("PRAGMA cell_size_check=ON")
            exported = ExportedRun(file, size, connection)
        yield exported


@contextmanager
def explained(file: Path) -> Iterator[None]:
    """Raise errors of SQLite as RunError with one line, without the sender's text in it."""
    try:
        yield
    except (sqlite3.Error, UnicodeError) as error:
        message = "cannot decode" if isinstance(error, UnicodeError) else str(error)
        reason = "it is damaged"
        if "interrupted" in message:
            reason = "reading it takes too long"
        elif "too big" in message:
            reason = f"it has a value of more than {LONGEST_VALUE // 2**20} MB"
        elif "decode" in message:
            reason = "it has text that is not UTF-8"
        elif "not a database" in message:
            reason = "this is something else"
        elif "unable to open" in message:
            reason = "it cannot be opened"
        raise RunError(f"{file}: expected an exported run (`robogauntlet export`), {reason}") from None


@cache
def _own_schema(version: int) -> dict[tuple[str, str, str], str]:
    """Tables and indexes of a version as SQLite describes them: (type, name, table) to the normalised SQL."""
    with closing(sqlite3.connect(":memory:")) as connection:
        for table in SCHEMA.metadata.sorted_tables:
            connection.execute(str(sa.schema.CreateTable(table).compile(dialect=sqlite.dialect())))
            for index in table.indexes:
                connection.execute(str(sa.schema.CreateIndex(index).compile(dialect=sqlite.dialect())))
        for name in columns_after(version):
            connection.execute(f"ALTER TABLE {episodes.name} DROP COLUMN {name}")
        return _schema_of(connection)


def _schema_of(connection: sqlite3.Connection) -> dict[tuple[str, str, str], str]:
    """The schema of a database, cut off where it is longer than ours can be; empty if it names something twice."""
    found = connection.execute("SELECT type, name, tbl_name, sql FROM sqlite_master LIMIT 100").fetchall()
    schema = {(kind, name, table): " ".join(str(sql or "").split()) for kind, name, table, sql in found}
    return schema if len(schema) == len(found) else {}


def _check_schema(file: Path, connection: sqlite3.Connection) -> int:
    """Return the version of a file. Refuse a schema that is not ours to the letter; early exports lack two tables."""
    found = _schema_of(connection)
    version = _version_of(file, connection, found)
    own = _own_schema(version)
    late = {imported_runs.name, forgotten_runs.name}
    needed = {key for key in own if key[2] not in late}
    if not needed <= found.keys() <= own.keys() or any(own[key] != sql for key, sql in found.items()):
        raise RunError(
            f"{file}: expected an exported run (`robogauntlet export`), its tables are not those of this program"
        )
    return version


def _version_of(file: Path, connection: sqlite3.Connection, found: Mapping[tuple[str, str, str], str]) -> int:
    """Return the version that a file states in a table of ours; the present one if that table is not ours."""
    marker = ("table", SCHEMA.version_table.name, SCHEMA.version_table.name)
    if found.get(marker) != _own_schema(SCHEMA.version)[marker]:
        return SCHEMA.version
    versions = connection.execute(f"SELECT version FROM {SCHEMA.version_table.name} LIMIT 2").fetchall()
    version = versions[0][0] if len(versions) == 1 else None
    if type(version) is int and version in {SCHEMA.version, *SCHEMA.earlier}:
        return version
    got = f"version {version}" if type(version) is int else "no version"
    raise RunError(
        f"{file}: expected an exported run of version {SCHEMA.version}, got {got}; "
        "import it with the RoboGauntlet that wrote it"
    )


def _read_document(file: Path, connection: sqlite3.Connection) -> RunDocument:
    found = connection.execute("SELECT run_id, document FROM runs NOT INDEXED LIMIT 2").fetchall()
    if len(found) != 1:
        raise RunError(f"{file}: expected one exported run, got {'several' if found else 'none'}")
    ((run_id, text),) = found
    if not isinstance(text, str):
        raise RunError(f"{file}: expected the document of a run as text, got something else")
    document = parse_run(text, str(file))
    if document.run_id != run_id or not RUN_ID.fullmatch(run_id):
        raise RunError(f"{file}: its run id is not one of this program")
    if document.status is RunStatus.COMPLETE and document.rows_hash is None:
        raise RunError(f"{file}: expected a hash of the rows of a complete run, it has none")
    if fault := _plan_fault(document):
        raise RunError(f"{file}: its document is not one of this program: {fault}")
    return document


def _plan_fault(document: RunDocument) -> str | None:
    """Return what cannot be shown of a plan, or does not belong into a suite, or None."""
    suite, names = document.suite, {cell.policy for cell in document.plan}
    texts = (text for cell in document.plan for text in (cell.policy, cell.task, cell.axis, cell.simulator))
    if not all(text.isprintable() for text in texts):
        return "a name in its plan has control characters"
    sides = [name for entry in (suite.merging, suite.compare) if entry is not None for _, name in entry.places()]
    named = {*sides, *suite.reference_policies}
    if not named <= names:
        return f"its suite compares policy '{min(named - names)}', which it does not play"
    if any(environment.interpreter is not None for environment in suite.environments.values()):
        return "its suite names a program"
    return None


class _RowCheck:
    """Checks the rows of one run; `result` is the last one, with texts of together `length` characters."""

    result: EpisodeResult
    length: int

    def __init__(self, document: RunDocument) -> None:
        suite, fields = document.suite, describe_fields()
        self._cells = {(cell.policy_digest, cell.task, cell.axis, cell.severity) for cell in document.plan}
        other_rule = suite.protocol_with(1).success
        self._protocol = (
            *(suite.replan_every, ",".join(suite.cameras)),
            *(suite.image_size, str(suite.render_profile)),
            None if suite.protocol is ProtocolName.ROBOGAUNTLET else str(suite.protocol),
            None if other_rule is None else str(other_rule),
        )
        self._allowed = [
            _TYPES[kind] | ({type(None)} if nullable else frozenset()) for kind, nullable, _ in fields.values()
        ]
        self._places = {kind: [i for i, (of, _, _) in enumerate(fields.values()) if of is kind] for kind in _TYPES}
        self._known_types: set[tuple[type, ...]] = set()

    def fault(self, values: list[Any]) -> str | None:
        """Return what is wrong with a row, or None."""
        types = tuple(map(type, values))
        if types not in self._known_types:
            for name, kind, allowed in zip(FIELDS, types, self._allowed, strict=True):
                if kind not in allowed:
                    return f"{name} is of another type"
            self._known_types.add(types)
        for place in self._places[int]:
            if values[place] is not None and not 0 <= values[place] <= MAX_COUNT:
                return f"{FIELDS[place]} is out of bounds"
        for place in self._places[float]:
            if values[place] is not None and not math.isfinite(values[place]):
                return f"{FIELDS[place]} is no finite number"
        self.length = 0
        for place in self._places[str]:
            text = values[place] or ""
            if len(text) > LONGEST_TEXT or "\0" in text:
                return f"{FIELDS[place]} is too long or has the character NUL"
            self.length += len(text)
        for place in self._places[bool]:
            if values[place] not in (None, 0, 1):
                return f"{FIELDS[place]} is neither true nor false"
            values[place] = None if values[place] is None else bool(values[place])
        self.result = EpisodeResult(**dict(zip(FIELDS, values, strict=True)))
        return self._contradiction(self.result)

    def _contradiction(self, row: EpisodeResult) -> str | None:
        """Return in what a row of the right types contradicts the run or itself, or None."""
        if not _is_one_of(Status, row.status) or not _is_one_of(RenderProfile, row.render_profile):
            return "its status or render profile is unknown"
        if (row.policy_digest, row.task, row.axis, row.severity) not in self._cells:
            return "it is not planned"
        played = (row.replan_every, row.cameras, row.image_size, row.render_profile, row.protocol, row.success_rule)
        if played != self._protocol:
            return "its protocol is not that of the suite"
        if row.horizon > MAX_STEPS:
            return "horizon is out of bounds"
        episode = row.episode
        if (row.simulator, row.pair_id, row.episode_id) != (episode.simulator, episode.pair_id, episode.id):
            return "its id is not that of its episode"
        if row.routing_scores is not None and not _are_scores(row.routing_scores):
            return "routing_scores are no scores by name"
        return _behaviour_fault(row)


def _behaviour_fault(row: EpisodeResult) -> str | None:
    """Return in what the behaviour in an episode contradicts its meaning or the rest of the row, or None."""
    for name, (least, most) in _BOUNDS.items():
        value = getattr(row, name)
        if value is not None and not least <= value <= most:
            return f"{name} is out of bounds"
    for name in _STEPS:
        if (getattr(row, name) or 0) > row.steps:
            return f"{name} is larger than steps"
    if row.failure is not None and not _is_one_of(FailureKind, row.failure):
        return "its failure is of an unknown kind"
    if row.failure is not None and row.status != Status.FAILURE:
        return "it has a kind of failure and another status"
    if row.time_to_success is not None and row.status != Status.SUCCESS:
        return "it has a time to success and another status"
    if row.status == Status.ERROR and has_behaviour(row):
        return "it is an error and has a behaviour"
    return None


def _is_one_of(kind: type[StrEnum], text: str) -> bool:
    return any(text == value for value in kind)


def _are_scores(text: str) -> bool:
    try:
        scores = parse_json(text)
    except ValueError:
        return False
    return isinstance(scores, dict) and all(
        isinstance(score, int | float) and math.isfinite(score) for score in scores.values()
    )
