"""A mapping file that is wrong is refused in a line for each mistake, which says what was expected."""

import pytest

from robogauntlet.adapters.contract import AdapterError
from robogauntlet.adapters.gymnasium.mapping import load_mapping
from tests.adapters.test_gymnasium import write_mapping
from tests.bad_input.cases_mappings import TEXTS, WRONG
from tests.bad_input.test_bad_input import LONGEST_LINE


@pytest.mark.parametrize(("place", "value", "says"), WRONG)
def test_a_wrong_value_is_named_with_its_place(tmp_path, place, value, says):
    refused(write_mapping(tmp_path, {place: value}), says)


@pytest.mark.parametrize(("text", "says"), TEXTS.items())
def test_a_text_that_is_no_mapping_is_refused(tmp_path, text, says):
    file = tmp_path / "Mine.yaml"
    file.write_bytes(text)
    refused(file, says)


def refused(file, says):
    with pytest.raises(AdapterError) as error:
        load_mapping(file)
    lines = str(error.value).splitlines()
    assert all(line.startswith(f"{file}: ") for line in lines)
    assert says in lines[0]
    assert max(map(len, lines)) <= LONGEST_LINE
