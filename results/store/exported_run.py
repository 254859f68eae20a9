"""An exported run: `run.json`, `episodes.parquet` and its media, if wanted, in a folder or a ZIP archive.

What comes from others is data: names, sizes and every value are checked, and the rows are copied into a new store.
"""

from __future__ import annotations

import re
import shutil
import zipfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from robogauntlet.results.media_paths import media_files
from robogauntlet.results.record import FIELDS, EpisodeResult, outcome_row, rows_hash
from robogauntlet.results.run_document import (
    RUN_FILE,
    STORE_FILE,
    RunDocument,
    RunError,
    RunStatus,
    parse_run,
    write_run,
)
from robogauntlet.results.store.arriving import arriving_folder
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.episodes_parquet import EPISODES_FILE, NoEpisodes, read_rows, write_parquet
from robogauntlet.results.store.exported_files import ExportedFile, exported_files
from robogauntlet.results.store.history_import import refuse_future
from robogauntlet.results.store.row_check import RowCheck
from robogauntlet.results.store.run_history import History

ARCHIVE = ".zip"
"""End of the name of an exported run that is an archive; every other name is that of a folder."""
RUN_ID = re.compile("[0-9a-f]{32}")
BATCH = 500
"""Rows of others that are held in memory at once: with the longest texts, some hundred MB."""


def export_run(folder: Path, document: RunDocument, rows: Store, target: Path, *, media: bool = False) -> int:
    """Write a run into a new archive or folder and return the number of rows. A crash leaves nothing of that name.

    Args:
        folder: The run folder.
        document: Its document.
        rows: Its rows.
        target: The file or folder to write, see `ARCHIVE`.
        media: Whether its videos and pictures are written, too.

    Raises:
        RunError: The target exists.
        StoreError: Rows cannot be read.
        OSError: The target cannot be written.
    """
    if target.exists() or target.is_symlink():
        raise RunError(f"{target}: expected a new file, there is one already")
    document = document.model_copy(update={"store_url": None})
    with arriving_folder(target.parent) as arriving:
        run, archive = arriving / "run", arriving / "archive"
        run.mkdir()
        write_run(run, document)
        count = write_parquet(run / EPISODES_FILE, document, rows)
        pictures = media_files(folder) if media else {}
        if target.suffix == ARCHIVE:
            with zipfile.ZipFile(archive, "w") as zipped:
                zipped.write(run / RUN_FILE, RUN_FILE, zipfile.ZIP_DEFLATED)
                for name, path in {EPISODES_FILE: run / EPISODES_FILE, **pictures}.items():
                    zipped.write(path, name)
            archive.rename(target)
        else:
            for name, path in pictures.items():
                (run / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(path, run / name)
            run.rename(target)
    return count


def import_run(
    source: Path, root: Path, *, name: str | None = None, check: Callable[[RunDocument], None] | None = None
) -> tuple[Path, RunDocument]:
    """Create a run folder from an exported run; return it and the document, whose origin is `imported`.

    Args:
        source: The exported run, an archive or a folder of others.
        root: Parent of the new folder.
        name: Name of the new folder; None for the suite's name and the start of the run's id.
        check: Called with the document before the folder is created; raises RunError to refuse it.

    Raises:
        RunError: It is no exported run, starts in the future, has changed rows, or the folder exists.
        StoreError: The rows cannot be written.
        OSError: The folder cannot be written.
    """
    with exported_files(source) as files:
        document = _read_document(files[RUN_FILE], source)
        with arriving_run(root, document, name, check) as (run, folder):
            for file in files.values():
                file.copy_to(run.parent if file.name == EPISODES_FILE else run)
            write_run(run, document)
            try:
                store_rows(run, document, _copied(run.parent / EPISODES_FILE, document))
            except NoEpisodes as error:
                raise RunError(f"{source}: expected the rows of run {document.run_id}, {error}") from None
    return folder, document


@contextmanager
def arriving_run(
    root: Path, document: RunDocument, name: str | None, check: Callable[[RunDocument], None] | None
) -> Iterator[tuple[Path, Path]]:
    """A folder to fill with a run of others, and the place to which it is moved if the block succeeds.

    Arguments and errors are those of `import_run`. The folder that the first is in is removed after the block.
    """
    with arriving_folder(root) as arriving:
        refuse_future(document)
        if check is not None:
            check(document)
        folder = root / (name or f"{document.suite.name}-{document.run_id[:8]}")
        if folder.exists():
            raise RunError(f"{folder}: expected a new folder, there is one already; name another with --out")
        run = arriving / "run"
        run.mkdir()
        write_run(run, document)
        yield run, folder
        run.rename(folder)


def _read_document(file: ExportedFile, source: Path) -> RunDocument:
    """Return the document as an import has it. Raises RunError."""
    document = parse_run(file.read().decode(errors="replace"), f"{source}: {RUN_FILE}")
    if not RUN_ID.fullmatch(document.run_id):
        raise RunError(f"{source}: its run id is not one of this program")
    if document.status is RunStatus.COMPLETE and document.rows_hash is None:
        raise RunError(f"{source}: expected a hash of the rows of a complete run, it has none")
    return document.model_copy(update={"origin": "imported", "command": None, "arguments": None, "store_url": None})


def store_rows(run: Path, document: RunDocument, batches: Iterable[Sequence[EpisodeResult]]) -> None:
    """Write the rows of a run of others into a new store in its folder.

    Raises:
        NoEpisodes: An episode is there twice, or the rows have another hash than the document says.
        StoreError: They cannot be written.
    """
    with closing(Store.open_file(run / STORE_FILE, document.run_id)) as store:
        history = History(store.database)
        history.record(document)
        found = rows_hash(_stored(batches, store))
        if document.rows_hash not in (None, found):
            raise NoEpisodes(f"these hash to {found}, not {document.rows_hash}: they were changed")
        history.record(document, counted=history.count_cells(document.run_id))


def _stored(batches: Iterable[Sequence[EpisodeResult]], store: Store) -> Iterator[tuple[Any, ...]]:
    for rows in batches:
        if store.add(rows) != len(rows):
            raise NoEpisodes("an episode is there twice")
        yield from map(outcome_row, rows)


def _copied(file: Path, document: RunDocument) -> Iterator[Sequence[EpisodeResult]]:
    """The checked rows of a file of others. Raises NoEpisodes."""
    check = RowCheck(document)
    for values in read_rows(file, document, BATCH):
        rows = [EpisodeResult(**dict(zip(FIELDS, row, strict=True))) for row in values]
        if fault := next(filter(None, map(check.fault, rows)), None):
            raise NoEpisodes(f"a row is not one of this program: {fault}")
        yield rows
