"""The page about one's own policy leads from an empty folder to a table."""

import re
import socket
from contextlib import ExitStack

import pytest
from PIL import Image

from tests.tutorials import follow

pytestmark = [pytest.mark.simulator, pytest.mark.ray, pytest.mark.nightly]


def found(printed, *words):
    """What the only command with these words printed."""
    (text,) = (text for line, text in printed.items() if all(word in line for word in words))
    return text


def free_ports(count):
    with ExitStack() as stack:
        places = [stack.enter_context(socket.socket()) for _ in range(count)]
        for place in places:
            place.bind(("127.0.0.1", 0))
        return [str(place.getsockname()[1]) for place in places]


def test_the_section_about_functions_leads_to_a_table_with_a_policy_that_passes_its_check(tmp_path):
    printed = follow("your-policy", "Python functions", tmp_path)
    assert "3 passed" in found(printed, "pytest")
    assert " 0 failed, " in found(printed, "check python:mypolicy:Mypolicy")
    assert Image.open(tmp_path / "mypolicy" / "runs" / "policy-check.png").width > 500
    assert "10 of 10 episodes" in found(printed, "run mypolicy.yaml")
    assert re.search(r"dx .* moves the tool forward \(\+x\)", found(printed, "check python:reach:act"))
    assert "ok       state        the same episode after another one: the same actions" in found(printed, "memory")


def test_the_section_about_servers_leads_to_a_table_with_numbers_that_mean_what_they_should(tmp_path):
    ports = dict(zip(("8000", "8001"), free_ports(2), strict=True))
    printed = follow("your-policy", "Policy servers", tmp_path, replaced=ports.items())
    assert "serving untrained" in found(printed, "serve policy untrained")
    before, after = (text for line, text in printed.items() if "check policy" in line)
    assert re.search(r"warning  translation .* look normalised", before)
    assert re.search(r"ok       translation  up to 0\.00\d+ m per step", after)
    assert "note     gripper      always -1: it never closes" in after
    assert "5 of 5 episodes" in found(printed, "run --policy")
    assert "5 of 5 episodes" in found(printed, "run forward.yaml")
