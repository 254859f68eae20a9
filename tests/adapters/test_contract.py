"""What the contract's values refuse."""

import pytest

from robogauntlet.adapters.contract import Goal


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"entry": ""}, "entry: expected the name of an entry"),
        *(({"axes": axes}, "axes: expected letters out of 'xyz'") for axes in ("", "xw", "X", "xx")),
        *(
            ({"offset": offset}, "offset: expected 1 or 3 finite numbers")
            for offset in ((), (0.0, 0.0), (float("nan"),))
        ),
        ({"entry": "hinge_angle"}, "offset: expected a change from the start"),
        *(
            ({"tolerance": value}, "tolerance: expected a finite number")
            for value in (-0.01, float("inf"), float("nan"))
        ),
    ],
)
def test_a_goal_that_cannot_be_measured_is_refused_with_the_name_of_the_value(values, says):
    with pytest.raises(ValueError, match=f"^{says}"):
        Goal(**{"entry": "cube_position", **values})


def test_a_goal_takes_any_axes_once_and_an_offset_for_all_or_for_each():
    assert Goal("cube_position", axes="zx", offset=(0.0, 0.0, 0.1)).axes == "zx"
    assert Goal("hinge_angle", offset=(0.3,)).offset == (0.3,)
