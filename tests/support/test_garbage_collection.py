"""The garbage collector is paused while a process starts, and collects afterwards."""

import gc
import weakref

import pytest

from robogauntlet.support.garbage_collection import collector_paused


class Cycle:
    def __init__(self):
        self.itself = self


@pytest.fixture(autouse=True)
def unfrozen():
    yield
    gc.unfreeze()


def fail_while_paused():
    with collector_paused():
        assert not gc.isenabled()
        raise OSError("broken")


def test_it_collects_afterwards_also_if_the_block_fails():
    with pytest.raises(OSError, match="broken"):
        fail_while_paused()
    assert gc.isenabled()
    gone = weakref.ref(Cycle())
    gc.collect()
    assert gone() is None


def test_it_ignores_what_the_block_has_made():
    with collector_paused():
        kept = weakref.ref(Cycle())
    gc.collect()
    assert kept() is not None


def test_it_stays_paused_where_it_was():
    gc.disable()
    try:
        with collector_paused():
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()
