"""The page on security: every row about what is not trusted is held by tests that exist."""

import ast
import re

import pytest

from tests import ROOT

PAGE = (ROOT / "docs" / "security.md").read_text(encoding="utf-8")
NAMED = re.compile(r"`(test_\w+)`")


@pytest.fixture(scope="module")
def functions():
    """Names of all test functions."""
    trees = (ast.parse(path.read_text(encoding="utf-8")) for path in (ROOT / "tests").rglob("test_*.py"))
    return {node.name for tree in trees for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}


def test_every_test_that_the_page_names_exists(functions):
    named = set(NAMED.findall(PAGE))
    assert len(named) > 20
    assert named - functions == set()


def test_every_row_of_what_is_not_trusted_names_a_test():
    section = PAGE.partition("\n## Not trusted\n")[2].partition("\n## ")[0]
    rows = [line for line in section.splitlines() if line.startswith("| ")][1:]
    assert len(rows) > 10
    assert [row for row in rows if not NAMED.search(row)] == []
