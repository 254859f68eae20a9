"""The package of a new adapter, which works on a toy until the author replaces it."""

from __future__ import annotations

from pathlib import Path

from robogauntlet.support.scaffold import Template

TEMPLATE = Template(Path(__file__).parent / "template", "toysim", "-")
