"""Memory that is free for this process."""

from types import SimpleNamespace

import psutil
import pytest

from robogauntlet.support.memory import available_memory

MACHINE = 1000


@pytest.fixture
def group(tmp_path, monkeypatch):
    """Write a control group below the folder `groups`."""
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=MACHINE))

    def write(name, limit, used=0, cached=0):
        folder = tmp_path / "groups" / name
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "memory.max").write_text(f"{limit}\n")
        (folder / "memory.current").write_text(f"{used}\n")
        (folder / "memory.stat").write_text(f"anon {used - cached}\ninactive_file {cached}\n")

    return write


def available(tmp_path, own):
    (tmp_path / "own").write_text(f"1:name=systemd:/\n0::{own}\n")
    return available_memory(tmp_path / "groups", tmp_path / "own")


def test_a_limit_of_the_own_group_counts_and_files_that_can_be_dropped_do_not(group, tmp_path):
    group("job/step", 500, used=300, cached=100)
    assert available(tmp_path, "/job/step") == 300


def test_a_limit_of_a_group_around_it_counts(group, tmp_path):
    group("job/step", "max", used=300)
    group("job", 400, used=350)
    assert available(tmp_path, "/job/step") == 50


def test_in_a_container_the_limit_is_at_the_root(group, tmp_path):
    group("", 500, used=100)
    assert available(tmp_path, "/../somewhere/else") == 400


def test_a_group_above_its_limit_has_nothing_left(group, tmp_path):
    group("", 500, used=600)
    assert available(tmp_path, "/") == 0


def test_without_a_limit_it_is_what_the_machine_has(group, tmp_path):
    group("job", "max", used=300)
    assert available(tmp_path, "/job") == MACHINE
    assert available_memory(tmp_path / "none", tmp_path / "neither") == MACHINE
