"""NOTICE: it names what is installed under terms that ask something of the user, and nothing that is not there."""

import importlib.metadata
import re
import subprocess
import tarfile
import tomllib

import pytest
from packaging.utils import canonicalize_name

from tests import ROOT

NOTICE = (ROOT / "NOTICE").read_text(encoding="utf-8")
NAMED = {
    canonicalize_name(name): licence
    for name, licence in re.findall(r"(?:^- |, )([\w-]+) \(([^)]+)\)", NOTICE, re.MULTILINE)
}
ASKS = re.compile(r"\b[AL]?GPL|GNU |affero|non-?commercial|CC-BY-NC|\bMPL|mozilla", re.IGNORECASE)
FAMILY = re.compile(r"AGPL|LGPL|GPL|MPL|MIT|Apache|BSD|zlib", re.IGNORECASE)


def licence_of(distribution):
    """What the metadata say of the licence; a licence's whole text, which some put into the field, is left out."""
    metadata = distribution.metadata
    words = [metadata.get("License-Expression", ""), (metadata.get("License") or "").partition("\n")[0]]
    return " ".join(words + [name for name in metadata.get_all("Classifier") or [] if name.startswith("License")])


INSTALLED = {canonicalize_name(item.name): licence_of(item) for item in importlib.metadata.distributions()}


def test_every_distribution_that_notice_names_is_pinned_or_installed():
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pinned = {canonicalize_name(line.partition("==")[0]) for line in lines}
    # The regular expression above may have found nothing, or half.
    assert len(NAMED) > 18
    assert NAMED.keys() - pinned - INSTALLED.keys() == set()


def test_every_installed_distribution_with_copyleft_or_noncommercial_terms_is_in_notice():
    asking = {name for name, licence in INSTALLED.items() if ASKS.search(licence)}
    assert asking - NAMED.keys() == set()


@pytest.mark.parametrize("name", sorted(name for name in NAMED if FAMILY.search(INSTALLED.get(name, ""))))
def test_the_licence_in_notice_is_that_of_the_metadata(name):
    families = {word.upper() for word in FAMILY.findall(INSTALLED[name])}
    assert {word.upper() for word in FAMILY.findall(NAMED[name])} <= families


def test_the_program_inside_imageio_ffmpeg_has_the_licence_that_notice_states():
    ffmpeg = pytest.importorskip("imageio_ffmpeg").get_ffmpeg_exe()
    printed = subprocess.run([ffmpeg, "-L"], capture_output=True, text=True, check=False).stdout
    assert re.search(r"GNU General Public License as published by\s.*\s?either version 3", printed, re.DOTALL)
    assert "GPL-3.0-or-later: `ffmpeg -L` prints it" in NOTICE


def test_maniskills_own_description_says_what_notice_says_of_its_assets():
    pytest.importorskip("mani_skill")
    description = importlib.metadata.metadata("mani_skill")["Description"]
    assert "The assets are licensed under [CC BY-NC 4.0]" in description
    assert "CC BY-NC 4.0" in NOTICE


def test_the_folders_and_the_licence_of_liberos_archive_are_those_in_notice():
    data = ROOT / "tests" / "data"
    with tarfile.open(data / "libero-assets.tar.xz") as archive:
        folders = {parts[1] for name in archive.getnames() if len(parts := name.split("/")) > 2}
        licence = archive.extractfile("assets/LICENSE-LIBERO").read()
    assert {folder for folder in folders if folder.endswith("_objects")} - {"articulated_objects"} == set(
        re.findall(r"^    (\w+_objects) ", NOTICE, re.MULTILINE)
    )
    assert licence == (data / "libero-assets.LICENSE").read_bytes()


def test_the_wheels_licence_files_are_there():
    files = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["license-files"]
    assert files == ["LICENSE", "NOTICE"]
    assert all((ROOT / name).is_file() for name in files)
