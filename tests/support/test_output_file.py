"""Files that a command writes where its user says."""

import os
import re

import pytest

from robogauntlet.support.errors import BadInput
from robogauntlet.support.output_file import Output

LIST = Output("a list", re.compile(rb"- "))


@pytest.mark.parametrize("before", [None, b"", b"- an earlier one\n"])
def test_it_is_new_or_replaces_what_such_a_command_wrote(tmp_path, before):
    file = tmp_path / "list"
    if before is not None:
        file.write_bytes(before)
    LIST.check(file)
    LIST.write(file, "- now\n")
    assert file.read_text() == "- now\n"
    assert list(tmp_path.iterdir()) == [file]


def test_any_other_file_stays_as_it_is_also_behind_a_link(tmp_path):
    (tmp_path / "mine").write_text("mine")
    (tmp_path / "link").symlink_to("mine")
    for name in ("mine", "link"):
        with pytest.raises(BadInput, match=f"{name}: expected a new file, or a list to replace, this is another file"):
            LIST.write(tmp_path / name, "- now\n")
    assert (tmp_path / "mine").read_text() == "mine"


def test_a_link_to_nothing_is_replaced_and_not_followed(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "there")
    LIST.write(tmp_path / "link", "- now\n")
    assert not (tmp_path / "there").exists()


def test_what_is_no_file_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(BadInput, match="pipe: expected a file to write, this is a named pipe"):
        LIST.check(tmp_path / "pipe")
    with pytest.raises(BadInput, match="x: expected a file in an existing folder"):
        LIST.check(tmp_path / "nowhere" / "x")
