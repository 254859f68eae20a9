"""Refuses to build where the folders of the package are not links, as that would make a wheel without them."""

from pathlib import Path

from setuptools import setup

if not (Path(__file__).parent / "src" / "robogauntlet" / "suites").is_dir():
    raise SystemExit(
        "src/robogauntlet: expected links to the folders of the package, this checkout has files in their place; "
        "run git config core.symlinks true, and git checkout -- src"
    )

setup()
