"""The files of an exported run in a folder or a ZIP archive of others: only those expected, of bounded size."""

from __future__ import annotations

import shutil
import stat
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO

from robogauntlet.results.media_paths import is_media, media_files
from robogauntlet.results.run_document import RUN_FILE, RunError
from robogauntlet.results.store.episodes_parquet import EPISODES_FILE
from robogauntlet.support.files import open_regular

LARGEST_ARCHIVE = 64 * 2**30
"""Largest size of an archive, and of all its files (bytes)."""
LARGEST = {RUN_FILE: 16 * 2**20, EPISODES_FILE: 8 * 2**30}
"""Files that every exported run has, with their largest sizes (bytes)."""
LARGEST_MEDIUM = 2**30
"""Largest size of a video or a picture (bytes)."""
MOST_FILES = 200_000
METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
ENCRYPTED = 1
"""Bit of a ZIP file's flags."""


@dataclass(frozen=True)
class ExportedFile:
    """A file of an exported run, which is opened when it is read."""

    name: str
    """Path in the exported run."""
    open: Callable[[], IO[bytes]]

    def read(self) -> bytes:
        """Return its content."""
        with self.open() as file:
            return file.read(largest(self.name))

    def copy_to(self, folder: Path) -> None:
        """Copy it below a folder."""
        path = folder / self.name
        path.parent.mkdir(parents=True, exist_ok=True)
        with self.open() as file, path.open("wb") as copy:
            shutil.copyfileobj(file, copy)


def largest(name: str) -> int:
    """Return the largest size of a file of this name (bytes)."""
    return LARGEST.get(name, LARGEST_MEDIUM)


@contextmanager
def exported_files(source: Path) -> Iterator[Mapping[str, ExportedFile]]:
    """The files of an exported run by name, during the block.

    Raises:
        RunError: It is none, or cannot be read; errors of this kind that the block meets while it reads, too.
    """
    try:
        if source.is_dir():
            yield _in_folder(source)
            return
        with open_regular(source, LARGEST_ARCHIVE) as file:
            try:
                archive = zipfile.ZipFile(file)
            except (zipfile.BadZipFile, NotImplementedError, OSError, ValueError):
                raise _refused(source, "this is something else, or damaged") from None
            with archive:
                yield _in_archive(archive, source)
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, UnicodeError):
        raise _refused(source, "it is damaged") from None
    except OSError as error:
        if error.filename is None or not Path(error.filename).is_relative_to(source):
            raise  # of what the block writes
        inside = "" if Path(error.filename) == source else f"{Path(error.filename).relative_to(source)}: "
        raise _refused(source, f"{inside}{error.strerror}") from None


def _refused(source: Path, reason: str) -> RunError:
    return RunError(f"{source}: expected an exported run (`robogauntlet export`): {reason}")


def _in_folder(folder: Path) -> dict[str, ExportedFile]:
    files = {name: folder / name for name in LARGEST} | media_files(folder)
    return {name: ExportedFile(name, partial(open_regular, path, largest(name))) for name, path in files.items()}


def _in_archive(archive: zipfile.ZipFile, source: Path) -> dict[str, ExportedFile]:
    """The files of an archive by name. Raises RunError for one that no exported run has."""
    found = archive.infolist()
    if len(found) > MOST_FILES:
        raise _refused(source, f"it has more than {MOST_FILES:,} files")
    if sum(entry.file_size for entry in found) > LARGEST_ARCHIVE:
        raise _refused(source, f"its files are together larger than {LARGEST_ARCHIVE:,} bytes")
    files: dict[str, ExportedFile] = {}
    for entry in found:
        name = entry.filename
        if (name not in LARGEST and not is_media(name)) or name in files:
            raise _refused(source, f"it has a file {ascii(name)[:100]} too many")
        if stat.S_IFMT(entry.external_attr >> 16) not in (0, stat.S_IFREG):
            raise _refused(source, f"its {name} is a link or no file")
        if entry.header_offset < 0:
            raise _refused(source, "it is damaged")
        if entry.compress_type not in METHODS or entry.flag_bits & ENCRYPTED:
            raise _refused(source, f"its {name} is encrypted, or compressed by another method")
        if entry.file_size > largest(name):
            raise _refused(source, f"its {name} is larger than {largest(name):,} bytes")
        files[name] = ExportedFile(name, partial(archive.open, entry))
    if missing := [name for name in LARGEST if name not in files]:
        raise _refused(source, f"it has no {missing[0]}")
    return files
