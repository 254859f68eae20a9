"""Tools for authors of policies: the files of a new policy, and the check of any policy."""

from __future__ import annotations

from pathlib import Path

from robogauntlet.support.scaffold import Template

TEMPLATE = Template(Path(__file__).parent / "template", "toypolicy", "_")
