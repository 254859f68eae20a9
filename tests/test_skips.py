"""A test that is skipped because something is not installed fails the whole check."""

from types import SimpleNamespace

from robogauntlet.orchestrator import kit
from tests.conftest import lacking_skips, pytest_sessionfinish

KIT = kit.__file__
TESTS = "/here/tests/orchestrator/kit/adapter/test_checks.py"


def skipped(reason, file="/here/tests/test_it.py"):
    return SimpleNamespace(longrepr=(file, 1, f"Skipped: {reason}"))


def test_skips_count_unless_the_machine_cannot_do_more_or_a_conformance_test_lists_them():
    reports = [skipped("not installed: gearbox"), skipped("not installed: gearbox"), skipped("this machine has no GPU")]
    reports += [skipped("could not import 'gearbox'"), skipped("it has two arms", KIT), skipped("no kit", TESTS)]
    found = lacking_skips(reports)
    assert found == {"not installed: gearbox": 2, "could not import 'gearbox'": 1, "no kit": 1}


def test_the_whole_check_fails_for_them_and_says_how_many():
    written, stats = [], {"skipped": [skipped("not installed: gearbox")]}
    terminal = SimpleNamespace(stats=stats, write_line=lambda line, **_: written.append(line))
    manager = SimpleNamespace(get_plugin={"terminalreporter": terminal}.get)
    for whole, status in ((False, 0), (True, 1)):
        config = SimpleNamespace(getoption={"whole": whole}.get, pluginmanager=manager)
        session = SimpleNamespace(config=config, exitstatus=0)
        pytest_sessionfinish(session)
        assert session.exitstatus == status
    assert written == ["\nexpected all to be installed, 1 skipped: not installed: gearbox"]
