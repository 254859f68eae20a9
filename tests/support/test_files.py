"""Files of others are regular and bounded; files and folders are written whole or not at all."""

import fcntl
import os
import signal
import socket
import subprocess
import sys
import threading

import pytest

from robogauntlet.support.files import (
    exclusive,
    is_held,
    new_folder,
    open_regular,
    read_regular,
    replacing,
    write_whole,
)
from tests.full_disk import full_disk


def names(folder):
    return [path.name for path in folder.iterdir()]


def test_a_link_in_place_of_the_part_is_not_followed(tmp_path):
    (tmp_path / "mine").write_text("mine")
    (tmp_path / ".file.partial").symlink_to("mine")
    with replacing(tmp_path / "file") as partial:
        partial.write_text("new")
    assert (tmp_path / "mine").read_text() == "mine"
    assert (tmp_path / "file").read_text() == "new"


def test_a_file_is_replaced_when_all_of_it_is_written(tmp_path):
    target = tmp_path / "file"
    target.write_text("old")
    with replacing(target) as partial:
        partial.write_text("new")
        assert target.read_text() == "old"
    assert target.read_text() == "new"
    write_whole(target, "é")
    assert target.read_bytes() == "é".encode()
    write_whole(target, b"bytes")
    assert names(tmp_path) == ["file"]
    assert target.read_bytes() == b"bytes"


def test_a_full_disk_leaves_the_old_file_and_nothing_else(tmp_path):
    target = tmp_path / "file"
    target.write_text("old")
    with full_disk(), pytest.raises(OSError, match="File too large"):
        write_whole(target, "x" * 5000)
    assert names(tmp_path) == ["file"]
    assert target.read_text() == "old"


def test_a_killed_process_leaves_the_old_file_and_its_own_is_overwritten(tmp_path):
    target = tmp_path / "file"
    target.write_text("old")
    code = (
        "import os, pathlib, signal, robogauntlet.support.files as files\n"
        f"with files.replacing(pathlib.Path({str(target)!r})) as partial:\n"
        "    partial.write_text('half')\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -signal.SIGKILL
    assert target.read_text() == "old"
    assert (tmp_path / ".file.partial").read_text() == "half"
    with replacing(target) as partial:
        assert not partial.exists()
        partial.write_text("new")
    assert names(tmp_path) == ["file"]


def test_a_folder_is_there_with_all_its_files_or_not(tmp_path):
    with full_disk(), pytest.raises(OSError, match="File too large"), new_folder(tmp_path / "folder") as partial:
        (partial / "one").write_text("x" * 5000)
    assert names(tmp_path) == []
    with new_folder(tmp_path / "folder") as partial:
        (partial / "one").touch()
        assert not (tmp_path / "folder").exists()
    assert names(tmp_path) == ["folder"]
    assert names(tmp_path / "folder") == ["one"]
    assert (tmp_path / "folder").stat().st_mode & 0o777 == 0o777 & ~_umask()


def _umask():
    umask = os.umask(0)
    os.umask(umask)
    return umask


def test_a_lock_is_held_by_one_process_and_released_after_the_block(tmp_path):
    code = (
        "import pathlib, robogauntlet.support.files as files\n"
        f"with files.exclusive(pathlib.Path({str(tmp_path / 'lock')!r}), SystemExit(3)): pass"
    )
    with exclusive(tmp_path / "lock", ValueError("taken")):
        assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 3
        with pytest.raises(ValueError, match="taken"), exclusive(tmp_path / "lock", ValueError("taken")):
            pass
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_file_of_others_is_read_within_its_limit(tmp_path):
    path, link = tmp_path / "file", tmp_path / "link"
    path.write_bytes(b"12345")
    link.symlink_to(path)
    assert read_regular(link, 5) == b"12345"
    with open_regular(path) as file:
        assert file.read(2) == b"12"
    with pytest.raises(OSError, match=r"^more than 4 bytes$"):
        read_regular(path, 4)
    with pytest.raises(FileNotFoundError):
        read_regular(tmp_path / "absent")


def test_a_path_that_is_no_regular_file_is_refused_without_waiting(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "endless").symlink_to("/dev/zero")
    (tmp_path / "folder").mkdir()
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(tmp_path / "socket"))
        for name, kind in {"pipe": "named pipe", "endless": "device", "folder": "folder", "socket": "socket"}.items():
            with pytest.raises(OSError, match=f"^a {kind}, no regular file$"):
                read_regular(tmp_path / name)


def test_a_large_file_of_holes_is_refused_and_a_written_one_is_not(tmp_path):
    holes, written = tmp_path / "holes", tmp_path / "written"
    for path, content in ((holes, b"x"), (written, bytes(7_000_000))):
        path.write_bytes(content)
        os.truncate(path, 65_000_000)
    with pytest.raises(OSError, match="65,000,000 bytes of holes"):
        open_regular(holes)
    with open_regular(written) as file:
        assert file.tell() == 0


def test_a_look_at_a_lock_keeps_nobody_from_it(tmp_path):
    lock = tmp_path / "lock"
    assert not is_held(lock)
    with exclusive(lock, ValueError("taken")):
        assert is_held(lock)
    with lock.open("wb") as looking:
        fcntl.flock(looking, fcntl.LOCK_SH)
        assert not is_held(lock)
        end = threading.Timer(0.1, fcntl.flock, (looking, fcntl.LOCK_UN))
        end.start()
        with exclusive(lock, ValueError("taken")):
            assert is_held(lock)
        end.join()
