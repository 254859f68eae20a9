"""Temporary folders are of this user alone, or refused in one line."""

import os
import stat

import pytest

from robogauntlet.support.private_folder import NoPrivateFolder, new_session_folder, private_folder


def test_a_private_folder_is_made_closed_to_others_and_used_again(tmp_path):
    folder = private_folder(tmp_path / "mine")
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert private_folder(folder) == folder


def _open_to_others(path):
    path.mkdir()
    path.chmod(0o775)


def _link(path):
    private_folder(path.parent / "other")
    path.symlink_to(path.parent / "other")


def _of_another_user(path):
    path.mkdir(mode=0o700)
    if os.getuid() != 0:
        pytest.skip("this machine lets only root act as a second user")
    os.chown(path, 65534, 65534)


def test_a_folder_that_others_could_only_read_is_closed_to_them(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine").chmod(0o755)
    assert stat.S_IMODE(private_folder(tmp_path / "mine").stat().st_mode) == 0o700


@pytest.mark.parametrize("made", [_open_to_others, _link, _of_another_user])
def test_a_folder_that_another_user_can_use_is_refused(made, tmp_path):
    made(tmp_path / "taken")
    with pytest.raises(NoPrivateFolder, match=r"taken: expected a folder of this user .* set TMPDIR$"):
        private_folder(tmp_path / "taken")


def test_a_session_has_a_short_private_folder_whatever_tmpdir_is(tmp_path, monkeypatch):
    long = tmp_path / ("x" * 80)
    long.mkdir()
    for place, expected in ((tmp_path, tmp_path), (long, "/tmp"), (tmp_path / "missing", "/tmp")):
        monkeypatch.setattr("tempfile.tempdir", str(place))
        folder = new_session_folder(len(str(tmp_path)) + len("/rg12345678"))
        try:
            assert str(folder.parent) == str(expected)
            assert stat.S_IMODE(folder.stat().st_mode) == 0o700
        finally:
            folder.rmdir()


def test_where_no_folder_is_short_enough_the_message_says_how_short(monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", "/" + "x" * 80)
    with pytest.raises(NoPrivateFolder, match=r"is too long by 81; .* set TMPDIR to a folder of at most 0 characters$"):
        new_session_folder(11)
