"""The pages on operating and on several machines: what they say is held by tests that exist."""

import ast
import re

import pytest

from tests import ROOT

PAGE, CLUSTER = ((ROOT / "docs" / name).read_text(encoding="utf-8") for name in ("operating.md", "cluster.md"))
NAMED = re.compile(r"`(test_\w+)`")


@pytest.fixture(scope="module")
def functions():
    """Names of all test functions."""
    trees = (ast.parse(path.read_text(encoding="utf-8")) for path in (ROOT / "tests").rglob("test_*.py"))
    return {node.name for tree in trees for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}


@pytest.mark.parametrize(("page", "at_least"), [(PAGE, 20), (CLUSTER, 5)], ids=["operating", "cluster"])
def test_every_test_that_a_page_names_exists(functions, page, at_least):
    named = set(NAMED.findall(page))
    assert len(named) > at_least
    assert named - functions == set()


def test_every_row_of_what_is_not_trusted_names_a_test():
    section = PAGE.partition("\n## Not trusted\n")[2].partition("\n## ")[0]
    rows = [line for line in section.splitlines() if line.startswith("| ")][1:]
    assert len(rows) > 10
    assert [row for row in rows if not NAMED.search(row)] == []


@pytest.mark.parametrize("title", ["What each node needs", "What fails, and what happens"])
def test_every_row_of_what_a_cluster_does_says_what_holds_it(title):
    table = CLUSTER.partition(f"\n## {title}\n")[2].lstrip().partition("\n\n")[0]
    rows = [line.split("|")[-2].strip() for line in table.splitlines()[2:]]
    assert len(rows) > 4
    assert [
        row for row in rows if not (NAMED.search(row) or row.startswith(("not tried", "the same", "`python -m")))
    ] == []
