"""The command line starts fast, describes each verb once, and helps with typing."""

import inspect
import resource
import sys
from importlib import import_module
from importlib.metadata import version

import pytest
import typer
from typer.main import get_command

from robogauntlet.orchestrator.cli import VERBS, app
from tests.processes import run_process

HEAVY = ("scipy", "sqlalchemy", "pandas", "numpy", "ray", "torch", "yaml", "rich.table", "robogauntlet.suites")
MOST_VERBS, MOST_LEAVES = 16, 33


def functions(verbs, above=""):
    """Each verb that is a function, or an application of its own: its address and its help."""
    for name, (below, line) in verbs.items():
        yield from [(above + name, below, line)] if isinstance(below, str) else functions(below, f"{above}{name} ")


FUNCTIONS = [*functions(VERBS)]


def run_main(*arguments, **variables):
    code = "import sys; sys.argv[0] = 'robogauntlet'\nfrom robogauntlet.orchestrator.cli import main; main()"
    return run_process([sys.executable, "-c", code, *arguments], **variables)


def test_help_imports_no_verb_and_no_heavy_library():
    verbs = [f"robogauntlet.orchestrator.cli{address.partition(':')[0]}" for _, address, _ in FUNCTIONS]
    code = (
        "import sys; sys.argv = ['robogauntlet', '--help']\nfrom robogauntlet.orchestrator.cli import main\n"
        "try: main()\nexcept SystemExit: pass\n"
        f"print([name for name in {[*verbs, *HEAVY]} if name in sys.modules])"
    )
    assert run_process([sys.executable, "-c", code]).stdout.splitlines()[-1] == "[]"


def test_all_simulators_and_their_tasks_are_known_without_a_library_that_workers_need():
    code = (
        "import sys, robogauntlet.orchestrator.cli.run\nfrom robogauntlet.adapters.catalog import simulators\n"
        "assert all(simulator.tasks for simulator in simulators().values())\n"
        "print([name for name in ('scipy', 'pandas', 'ray', 'torch', 'PIL') if name in sys.modules])"
    )
    assert run_process([sys.executable, "-c", code]).stdout == "[]\n"


def test_help_takes_less_than_half_a_second_of_cpu():
    run_main("--help")  # compiles
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert run_main("--help").returncode == 0
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 0.5


def test_version_is_that_of_the_distribution():
    assert run_main("--version").stdout == f"robogauntlet {version('robogauntlet')}\n"


def test_a_mistyped_verb_gets_a_suggestion():
    done = run_main("resum")
    assert done.returncode == 2
    assert "No such command 'resum'. Did you mean 'resume'?" in done.stderr


def test_a_mistyped_option_of_a_verb_gets_no_hidden_suggestion():
    done = run_main("run", "demo", "--shcedule", "x")
    assert done.returncode == 2
    assert "--schedule" not in done.stderr


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_shell_completion_is_offered(shell):
    done = run_main("--show-completion", shell, _TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION="1")
    assert done.returncode == 0
    assert "_ROBOGAUNTLET_COMPLETE" in done.stdout
    assert "--install-completion" in run_main("--help").stdout


def test_verbs_are_completed():
    variables = {"COMP_WORDS": "robogauntlet sched", "COMP_CWORD": "1", "_ROBOGAUNTLET_COMPLETE": "complete_bash"}
    assert run_main(**variables).stdout.split() == ["schedule"]


@pytest.mark.parametrize(("verb", "address", "line"), FUNCTIONS)
def test_the_list_of_verbs_describes_a_verb_as_its_own_help_does(verb, address, line):
    module, _, name = address.partition(":")
    function = getattr(import_module(f"robogauntlet.orchestrator.cli{module}"), name)
    if not isinstance(function, typer.Typer):  # the help of a group is taken from the list
        assert inspect.getdoc(function).splitlines()[0] == line, verb


def test_there_are_few_verbs():
    group = get_command(app)
    assert len(VERBS) <= MOST_VERBS
    assert len([leaf for name in VERBS for leaf in leaves(group.get_command(None, name))]) <= MOST_LEAVES


def leaves(command):
    """The verbs of a group, and of groups in it; else the verb itself."""
    if not hasattr(command, "commands"):
        return [command]
    return [leaf for name in command.commands for leaf in leaves(command.get_command(None, name))]
