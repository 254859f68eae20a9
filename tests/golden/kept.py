"""Kept runs: a suite file, the run document as JSON, the rows as Parquet; written once, when the suite is played."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import pyarrow
from pyarrow import parquet

from robogauntlet.results.record import FIELDS, EpisodeResult, Status
from robogauntlet.results.run_document import RunDocument
from tests.golden.normal import json_text
from tests.results.synthetic import run_folder

HERE = Path(__file__).parent
RUNS = HERE / "runs"
KINDS = tuple(sorted(path.name for path in RUNS.iterdir() if path.is_dir()))
PLAYED, BASELINE = "suite", "baseline"
"""The kept run of a kind, and the run before it that some kinds keep, too."""
DAY = 86_400.0


@dataclass(frozen=True)
class KeptRun:
    """A kept run of a kind."""

    kind: str
    name: str = PLAYED

    @property
    def suite(self) -> Path:
        """Its suite file."""
        return RUNS / self.kind / f"{self.name}.yaml"

    @property
    def exists(self) -> bool:
        """Whether it is kept."""
        return self._document.exists()

    @property
    def _document(self) -> Path:
        return RUNS / self.kind / f"{self.name}.json"

    @property
    def _rows(self) -> Path:
        return RUNS / self.kind / f"{self.name}.parquet"

    @cached_property
    def document(self) -> RunDocument:
        """Its run document, with the text of the suite file."""
        kept = json.loads(self._document.read_text(encoding="utf-8"))
        text = self.suite.read_text(encoding="utf-8")
        return RunDocument.model_validate({**kept, "suite_text": text, "suite_path": f"{self.kind}.yaml"})

    @cached_property
    def rows(self) -> list[EpisodeResult]:
        """Its rows."""
        return [EpisodeResult(**row) for row in parquet.read_table(self._rows).to_pylist()]

    def keep(self, document: RunDocument, rows: list[EpisodeResult]) -> None:
        """Write a run: of the document what is no default, without what depends on the place; the rows by their id."""
        placed = {"suite_text", "suite_path", "command", "store_url", "format"}
        plain = document.model_dump(mode="json", exclude_defaults=True, exclude=placed)
        self._document.write_text(json_text(plain), encoding="utf-8")
        ordered = sorted(rows, key=lambda row: row.episode_id)
        table = pyarrow.table({name: [getattr(row, name) for row in ordered] for name in FIELDS})
        parquet.write_table(table, self._rows, compression="zstd", write_statistics=False)

    def build(self, folder: Path) -> Path:
        """Make a run folder of today's form, as of a run that was played in it."""
        return run_folder(folder, self.document, self.rows)


def build_earlier(kind: str, folder: Path) -> Path:
    """Make the folder of an earlier run: the kind's baseline, or the same run of which a fifth fared otherwise."""
    if (baseline := KeptRun(kind, BASELINE)).exists:
        return baseline.build(folder)
    kept = KeptRun(kind)
    document = kept.document
    finished = None if document.finished_at is None else document.finished_at - DAY
    times = {"started_at": document.started_at - DAY, "finished_at": finished}
    earlier = document.model_copy(update={"run_id": f"{document.run_id}-earlier", "rows_hash": None, **times})
    return run_folder(folder, earlier, [_otherwise(row) for row in kept.rows])


def _otherwise(row: EpisodeResult) -> EpisodeResult:
    drawn = hashlib.sha256(row.episode_id.encode()).digest()[0] % 5
    if drawn or row.status == Status.ERROR:
        return row
    won = row.status == Status.FAILURE
    changes = {"status": str(Status.SUCCESS if won else Status.FAILURE), "success_once": won, "failure": None}
    return replace(row, **changes)
