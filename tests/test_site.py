"""The documentation: it builds, every link in it has a target, and it agrees with the program."""

import base64
import io
import os
import re
import subprocess
import sys
from html import unescape
from urllib.parse import unquote, urlsplit

import numpy as np
import pytest
from PIL import Image
from typer import Context
from typer.main import get_command

from robogauntlet.orchestrator.cli import app
from scripts.site.convention import FILE, draw
from scripts.site.drawing import DOCS
from scripts.site.pictures import drawings, numbers
from tests import ROOT
from tests.doctor_messages import matches, templates

LOADED = re.compile(r'<(?:script|img|link|iframe|source|video)\b[^>]*?\s(?:src|href)="(https?:)?//')
LOADED_BY_STYLE = re.compile(r"(?:url\(|@import\s*)[\"']?(?:https?:)?//")
LINK = re.compile(r'\s(?:href|src)="([^"]*)"')
EXTERNAL = re.compile(r"\]\((https?:[^)\s]*)\)")


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    pytest.importorskip("material", reason="needs the extra 'docs': pip install -c constraints.txt -e '.[docs]'")
    folder = tmp_path_factory.mktemp("site")
    environment = {**os.environ, "PYTHONPATH": f"{ROOT / 'src'}{os.pathsep}{ROOT}", "NO_MKDOCS_2_WARNING": "1"}
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    build = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment, check=False)
    warnings = [line for line in (build.stdout + build.stderr).splitlines() if not line.startswith("INFO")]
    assert (build.returncode, warnings) == (0, [])
    return folder


@pytest.fixture(scope="module")
def pages(site):
    return {path: path.read_text(encoding="utf-8") for path in site.rglob("*.html")}


def test_reading_it_loads_nothing_from_the_network(site, pages):
    assert [path.name for path, html in pages.items() if LOADED.search(html)] == []
    styles = [path for path in site.rglob("*.css") if LOADED_BY_STYLE.search(path.read_text(encoding="utf-8"))]
    assert styles == []


def test_every_link_has_a_target(site, pages):
    anchors = {path: set(re.findall(r'\s(?:id|name)="([^"]*)"', html)) for path, html in pages.items()}
    broken = []
    for path, html in pages.items():
        if path.name == "404.html":  # its links begin at the address of the site
            continue
        for link in map(unescape, LINK.findall(html)):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not target.exists() or (parts.fragment and unquote(parts.fragment) not in anchors.get(target, ())):
                broken.append(f"{path.relative_to(site)}: {link}")
    assert broken == []


def test_every_external_link_is_an_address():
    for path in DOCS.rglob("*.md"):
        for link in EXTERNAL.findall(path.read_text(encoding="utf-8")):
            assert urlsplit(link).hostname, f"{path}: {link}"


def test_the_search_covers_the_pages(site):
    index = site / "search" / "search_index.json"
    assert "holm" in index.read_text(encoding="utf-8").lower()
    assert index.stat().st_size < 2_000_000


def commands(command, name):
    yield name, command
    context = Context(command)
    for sub in command.list_commands(context) if hasattr(command, "list_commands") else ():
        yield from commands(command.get_command(context, sub), f"{name} {sub}")


def test_the_reference_has_every_verb_and_option(site):
    page = unescape(re.sub(r"<[^>]+>", "", (site / "reference" / "cli.html").read_text(encoding="utf-8")))
    assert "--condition" in {
        option for _, one in commands(get_command(app), "") for p in one.params for option in p.opts
    }
    missing = [name for name, _ in commands(get_command(app), "robogauntlet") if name not in page]
    missing += [
        f"{name} {option}"
        for name, command in commands(get_command(app), "robogauntlet")
        for parameter in command.params
        if parameter.param_type_name == "option"
        for option in parameter.opts
        if option not in page
    ]
    assert missing == []


def test_the_drawings_are_what_their_script_draws():
    assert [path.name for path, text in drawings().items() if path.read_text(encoding="utf-8") != text] == []


@pytest.mark.simulator
def test_the_drawing_of_the_convention_is_what_its_script_draws():
    drawn, kept = draw(), FILE.read_text(encoding="utf-8")
    encoded = re.compile(r"data:image/jpeg;base64,([^\"]+)")
    assert encoded.sub("", drawn) == encoded.sub("", kept)
    for one, other in zip(encoded.findall(drawn), encoded.findall(kept), strict=True):
        images = [np.asarray(Image.open(io.BytesIO(base64.b64decode(text))), float) for text in (one, other)]
        assert np.abs(images[0] - images[1]).mean() < 2


def test_the_numbers_of_the_statistics_page_are_those_of_the_functions():
    page = " ".join((DOCS / "statistics.md").read_text(encoding="utf-8").split())
    expected = dict(numbers())
    pairs = expected.pop("screening, pairs").split(", ")
    del expected["45 of 50"]  # in the picture only
    missing = {name: number for name, number in expected.items() if number.replace("drop of ", "") not in page}
    assert missing == {}
    assert "in 86 both succeed, in 3 only the experts, in none only the merged model, in 1 neither" in page
    assert pairs == ["86", "3", "0", "1"]


def test_troubleshooting_has_every_line_of_the_doctor_and_no_other():
    page = (DOCS / "troubleshooting.md").read_text(encoding="utf-8")
    lines = [line for block in re.findall(r"```text\n(.*?)```", page, re.DOTALL) for line in block.splitlines()]
    known = templates()
    assert len(known) > 10
    assert [pieces for pieces in known if not any(matches(pieces, line) for line in lines)] == []
    assert [line for line in lines if not any(matches(pieces, line) for pieces in known)] == []
