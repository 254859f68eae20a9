"""The structure of the code: imports go one way, light modules stay light, files stay short."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests import ROOT

PACKAGES = {
    "support": set(),
    "suites": {"support"},
    "adapters": {"suites", "support"},
    "results": {"suites", "support"},
    "policies": {"suites", "adapters", "support"},
    "orchestrator": {"suites", "adapters", "results", "policies", "support"},
}
"""Package to the others that it may import."""
FLOORS = {
    "orchestrator": (
        ("episodes", "scheduling", "perturbations", "inference", "ray_runtime", "environments"),
        ("replay", "demonstrations"),
        ("runs",),
        ("kit",),
        ("api", "cli", "dashboard", "schedules", "trackers"),
    ),
    "results": (("statistics",), ("store", "analysis"), ("report",)),
}
"""Floors inside the rooms, the lowest first. A package imports only packages of its own floor and of those below."""
SOURCE = ROOT / "src" / "robogauntlet"
MERGEVLA = ROOT / "mergevla" / "robogauntlet_mergevla"
CONTRACTS = (
    *("adapters.contract", "adapters.catalog", "policies.contract", "suites.", "support."),
    *("results.record", "results.run_document", "results.statistics."),
    *("results.report.blocks", "results.report.section", "results.report.formatting"),
)
"""Modules, or their beginnings, that MergeVLA may import as every other distribution may."""
INNER = {"policies.hub", "policies.stored", "policies.training.dataset", "policies.training.lerobot_format"}
"""What MergeVLA reads checkpoints and demonstrations with."""
PLAYS = {
    *("orchestrator.cli.common", "orchestrator.cli.console_tables", "orchestrator.live_display"),
    *("orchestrator.environments.resolver", "orchestrator.episodes.rollout", "orchestrator.registry"),
    *("orchestrator.ray_runtime.session", "orchestrator.ray_runtime.simulator_processes"),
    *("results.analysis.routing", "results.folder_lock"),
}
"""What its verbs print with, and what the evaluation of routers collects first observations with."""
LONGEST = 400
BUDGETS = {
    "orchestrator": 23_486,
    "adapters": 10_454,
    "policies": 9_077,
    "mergevla": 9_389,
    "results": 16_086,
    "suites": 3_056,
    "src/robogauntlet": 983,
    "tests": 53_835,
}
"""Lines of Python that a room may have, templates left out. A commit that raises one says what went instead."""
WORDS = 32_000
"""Words that README, CONTRIBUTING, CHANGELOG and the pages in docs may have, without references and reports."""


def module_of(path):
    name = ".".join(path.relative_to(SOURCE.parent).with_suffix("").parts)
    return name.removesuffix(".__init__")


MODULES = {module_of(path): path for room in PACKAGES for path in (SOURCE / room).rglob("*.py")}
TEMPLATES = "robogauntlet.orchestrator.kit.template"
MODULES = {name: path for name, path in MODULES.items() if not name.startswith(TEMPLATES)}


def imports(path, *, late=True):
    """Modules of ours that a file imports; without `late`, only when it is itself imported."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    nodes = list(ast.walk(tree)) if late else [node for node in tree.body if not is_for_types(node)]
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = {f"{node.module}.{alias.name}" for alias in node.names}
            yield from names & MODULES.keys() or {node.module}


def is_for_types(node):
    return isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)


def test_no_import_runs_against_the_floors():
    found = set()
    for name, path in MODULES.items():
        _, room, *rest = name.split(".")
        floors = {package: floor for floor, packages in enumerate(FLOORS.get(room, ())) for package in packages}
        for other in imports(path):
            if not rest or not other.startswith(f"robogauntlet.{room}.") or rest[0] == other.split(".")[2]:
                continue
            others = other.split(".")[2:]
            climbs = floors.get(others[0], 0) > floors.get(rest[0], len(floors))
            if climbs or (rest[0], others[0]) == ("analysis", "store"):
                found.add(f"{name.removeprefix('robogauntlet.')} -> {room}.{others[0]}")
    assert found == set()


def test_every_package_has_a_floor():
    for room, floors in FLOORS.items():
        packages = {path.parent.name for path in (SOURCE / room).glob("*/__init__.py")}
        assert packages == {package for floor in floors for package in floor}


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_imports_only_the_packages_below_it(package):
    files = list((SOURCE / package).rglob("*.py"))
    assert files
    ours = {(path.name, name) for path in files for name in imports(path) if name.startswith("robogauntlet.")}
    allowed = PACKAGES[package] | {package}
    assert not {(path, name) for path, name in ours if name.split(".")[1] not in allowed}


def test_the_core_imports_nothing_of_mergevla():
    files = [*MODULES.values(), *(path for path in (ROOT / "src").rglob("*.py") if not in_link(path))]
    assert {path.name for path in files if "robogauntlet_mergevla" in path.read_text(encoding="utf-8")} == set()


def test_mergevla_imports_contracts_of_the_core_and_a_few_names_more():
    names = {name for path in MERGEVLA.rglob("*.py") for name in imports(path) if name.startswith("robogauntlet.")}
    modules = {name.removeprefix("robogauntlet.") for name in names}
    assert {name for name in modules if not name.startswith(CONTRACTS)} == {*INNER, *PLAYS}


def test_policies_depend_on_no_single_simulator():
    allowed = {f"robogauntlet.adapters.{name}" for name in ("contract", "catalog", "frames")}
    names = {name for path in (SOURCE / "policies").rglob("*.py") for name in imports(path)}
    assert {name for name in names if name.startswith("robogauntlet.adapters")} <= allowed


def test_private_names_of_libraries_are_imported_nowhere():
    private = re.compile(r"\b(ray|typer|click|pandas|scipy)\._[a-z]|type_descriptor|\bpandas\.core\b")
    found = {path.name for path in MODULES.values() if private.search(path.read_text(encoding="utf-8"))}
    assert found == set()  # orchestrator/ray_runtime/private_names.py asks for those of Ray, which may be absent


def test_no_module_imports_itself_through_others():
    edges = {name: {other for other in imports(path) if other in MODULES} - {name} for name, path in MODULES.items()}
    finished, circles = set(), []

    def visit(name, way):
        if name in way:
            circles.append(" -> ".join([*way[way.index(name) :], name]))
        elif name not in finished:
            for other in sorted(edges[name]):
                visit(other, [*way, name])
            finished.add(name)

    for name in sorted(edges):
        visit(name, [])
    assert circles == []


def loaded(code, *modules):
    """Those of the modules that are imported once the code has run."""
    code = f"import sys\n{code}\nprint([name for name in {modules!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return ast.literal_eval(done.stdout)


HEAVY = ("torch", "ray", "mani_skill", "sapien", "pybullet", "panda_gym", "robosuite", "mujoco")


@pytest.mark.parametrize(
    "module",
    ["results.statistics.pairs", "adapters.contract", "policies.contract", "adapters.catalog", "policies.catalog"],
)
def test_light_modules_load_no_simulator_no_torch_and_no_ray(module):
    assert loaded(f"import robogauntlet.{module}", *HEAVY) == []


def test_declaring_every_plugin_loads_no_simulator_and_no_torch():
    code = "from robogauntlet.orchestrator.registry import load_registry\nassert len(load_registry().tasks) > 9"
    assert loaded(code, "torch", "ray", "mani_skill", "sapien", "panda_gym", "mujoco") == []


def test_importing_the_package_loads_nothing_of_it():
    code = "import robogauntlet\nassert 'Episode' in dir(robogauntlet)"
    assert loaded(code, "numpy", "pydantic", *(f"robogauntlet.{package}" for package in PACKAGES)) == []


def test_every_public_name_is_there():
    import robogauntlet

    assert {name: getattr(robogauntlet, name) for name in robogauntlet.__all__}
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = robogauntlet.nothing


def test_no_file_is_longer_than_the_limit():
    folders = (*PACKAGES.keys() - {"support"}, "mergevla", "tests", "scripts", "src", "studies")
    files = [path for folder in folders for path in (ROOT / folder).rglob("*.py")]
    assert {str(p): n for p in files if (n := len(p.read_text(encoding="utf-8").splitlines())) > LONGEST} == {}


@pytest.mark.parametrize("room", BUDGETS)
def test_a_room_keeps_to_its_budget_of_lines(room):
    files = [path for path in (ROOT / room).rglob("*.py") if not {"template", "build"} & set(path.parts)]
    files = [path for path in files if not in_link(path)]
    lines = sum(len(path.read_text(encoding="utf-8").splitlines()) for path in files)
    assert lines <= BUDGETS[room]


def in_link(path):
    return any(parent.is_symlink() for parent in path.parents)


def test_the_pages_keep_to_their_budget_of_words():
    pages = [path for path in (ROOT / "docs").rglob("*.md") if not {"reference", "reports"} & set(path.parts)]
    pages += [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")]
    words = {path: len(path.read_text(encoding="utf-8").split()) for path in pages}
    assert sum(words.values()) <= WORDS
    assert words[ROOT / "README.md"] <= 900


def test_tests_have_the_same_packages_as_the_source():
    of_tests = ("data", "bad_input", "chaos", "fuzz", "golden")
    folders = {path.parent.relative_to(ROOT / "tests") for path in (ROOT / "tests").rglob("test_*.py")} - {Path()}
    places = {path: (MERGEVLA if path.parts[0] == "mergevla" else SOURCE / path.parts[0]) for path in folders}
    strays = [path for path, place in places.items() if not place.joinpath(*path.parts[1:]).is_dir()]
    assert [path for path in strays if path.parts[0] not in of_tests] == []
