"""Policies that are named by one text."""

import re
from pathlib import Path

import pytest

from robogauntlet.policies import catalog
from robogauntlet.policies.contract import PolicyError
from robogauntlet.policies.references import option_text, read_options, read_reference, with_options
from robogauntlet.support.errors import BadInput
from tests.errors import one_line_error


@pytest.mark.parametrize(
    ("text", "name", "kind", "options"),
    [
        ("oracle", "oracle", "oracle", {}),
        ("python:brain.arm:act", "python-brain.arm-act", "python", {"callable": "brain.arm:act"}),
        ("openpi://gpu:8000", "openpi-gpu-8000", "openpi", {"address": "openpi://gpu:8000"}),
        ("vla-eval://gpu:8000", "vla-eval-gpu-8000", "vla-eval", {"address": "vla-eval://gpu:8000"}),
        ("openvla+http://gpu:8000", "openvla-http-gpu-8000", "openvla", {"address": "openvla+http://gpu:8000"}),
        ("gr00t://gpu:5555", "gr00t-gpu-5555", "gr00t", {"address": "gr00t://gpu:5555"}),
        ("xpolicylab://gpu:19000", "xpolicylab-gpu-19000", "xpolicylab", {"address": "xpolicylab://gpu:19000"}),
        ("lerobot:/data/act", "lerobot-data-act", "lerobot", {"checkpoint": "/data/act"}),
        ("zoo:merged", "zoo-merged", "mergevla-merged", {"checkpoint": "zoo:merged"}),
        ("zoo:experts", "zoo-experts", "mergevla-experts", {"folder": "zoo:experts"}),
        ("zoo:base", "zoo-base", "mergevla", {"checkpoint": "zoo:base"}),
        (
            "zoo:experts/robosuite__Lift",
            "zoo-experts-robosuite__Lift",
            "mergevla",
            {"checkpoint": "zoo:experts/robosuite__Lift"},
        ),
    ],
)
def test_a_text_is_a_kind_with_its_options_and_a_name(text, name, kind, options):
    entry = read_reference(text)
    assert (entry.name, entry.kind) == (name, kind)
    assert entry.options == options


def public_models():
    """The servers in the manual's table of public models: a line, and the options of a cell that has any."""
    page = (Path(__file__).parents[2] / "docs" / "your-policy.md").read_text(encoding="utf-8")
    section = page.partition("\n## Public models\n")[2]
    short = dict(re.findall(r"\*\*(\w)\*\*[^`]+`([^`]+)`", section.replace("\n", " ")))
    for family, _, line, *cells in re.findall(r"^\| " + r"(.*?) \| ?" * 5 + r"(.*?) ?\|$", section, re.MULTILINE):
        for parts in (cell.split(", ") for cell in cells if "://" in line):
            given = [short.get(part, part.strip("`")) for part in parts if part in short or part[:1] == "`"]
            if given:
                yield pytest.param(line.strip("`"), ", ".join(given), id=family)


@pytest.mark.parametrize(("line", "given"), public_models())
def test_the_lines_and_options_of_public_models_are_taken(line, given):
    options = read_options([pair.replace(": ", "=") for pair in given.split(", ")])
    (entry,) = with_options([read_reference(line.replace("HOST:PORT", "gpu:8000"))], options)
    assert options.items() <= entry.options.items()
    catalog.find(entry.kind).wishes(entry.options)


def test_a_folder_of_a_checkpoint_is_a_policy(tmp_path):
    (tmp_path / "best").mkdir()
    (tmp_path / "best" / "card.json").write_text("{}")
    entry = read_reference(str(tmp_path / "best"))
    assert (entry.kind, entry.options) == ("mergevla", {"checkpoint": str(tmp_path / "best")})
    assert entry.name.endswith("-best")
    assert read_reference(str(tmp_path)).kind == "mergevla-experts"


@pytest.mark.parametrize("text", ["orcale", "no/such/folder", "python:"])
def test_a_text_that_names_no_policy_is_one_line(text):
    with one_line_error(BadInput, f"expected openpi://HOST:PORT or .* a kind of policy; got '{text}'"):
        read_reference(text)


def test_an_unknown_checkpoint_of_the_zoo_is_one_line():
    with one_line_error(PolicyError, "expected the name of a shipped checkpoint after 'zoo:', got 'mergd'"):
        read_reference("zoo:mergd")


def test_options_are_added_and_those_that_the_kind_lacks_are_refused():
    given = read_options(["router=nearest-centroid"])
    assert with_options([read_reference("zoo:merged")], given)[0].options == {
        "checkpoint": "zoo:merged",
        "router": "nearest-centroid",
    }
    with one_line_error(BadInput, "policy 'mergevla-merged' has no option 'roter'; did you mean 'router'?"):
        with_options([read_reference("zoo:merged")], {"roter": 1})


def test_options_are_values_in_yaml():
    options = {"image_size": 224, "columns": [0, None], "identity": "pi0", "on": True, "off": "yes: no"}
    texts = [option_text(name, value) for name, value in options.items()]
    assert read_options(texts) == options
    assert read_options(["image_size=224", "convention=libero"]) == {"image_size": 224, "convention": "libero"}
    for wrong in ("image_size", "=3", "cameras={"):
        with one_line_error(BadInput, "--option"):
            read_options([wrong])


def test_of_several_policies_an_option_goes_to_those_whose_kind_has_it():
    server, oracle = with_options([read_reference("openpi://h:1"), read_reference("oracle")], {"image_size": 224})
    assert server.options["image_size"] == 224
    assert oracle.options == {}


@pytest.mark.parametrize(
    ("text", "ends"),
    [
        ("nope", "got 'nope'"),
        ("randm", "got 'randm'; did you mean 'random'?"),
        (
            "https://gpu-box:8000",
            "got 'https://gpu-box:8000'; did you mean one of openpi://gpu-box:8000, openvla+https://gpu-box:8000?",
        ),
    ],
)
def test_a_suggestion_is_what_is_alike_or_nothing(text, ends):
    with pytest.raises(BadInput) as refused:
        read_reference(text)
    assert str(refused.value).endswith(ends)


@pytest.mark.parametrize("address", ["ws://gpu-box:8000", "wss://gpu-box"])
def test_the_address_of_a_websocket_is_a_policy_server(address):
    entry = read_reference(address)
    assert (entry.kind, entry.options) == ("openpi", {"address": address})
