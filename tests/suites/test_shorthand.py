"""Short forms of a suite's policies."""

import pytest

from suites.schema import PolicyEntry


@pytest.mark.parametrize(
    ("text", "entry"),
    [
        ("oracle", ("oracle", "oracle", {})),
        ("openpi://127.0.0.1:8000", ("openpi-127.0.0.1-8000", "openpi", {"address": "openpi://127.0.0.1:8000"})),
        ("python:brains.reach:Reach", ("python-brains.reach-Reach", "python", {"callable": "brains.reach:Reach"})),
    ],
)
def test_a_short_form_is_a_kind_with_its_one_option(text, entry):
    found = PolicyEntry.model_validate(text)
    assert (found.name, found.kind, found.options) == entry


@pytest.mark.parametrize("text", ["oracle:", "openpi:", "nobody:there", ":x", "python :x"])
def test_what_is_no_short_form_is_refused_as_a_name(text):
    with pytest.raises(ValueError, match="name"):
        PolicyEntry.model_validate(text)
