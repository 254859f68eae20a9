"""Recipes refuse values out of range when they are created."""

import pytest

from robogauntlet_mergevla.merging.errors import OutOfRange
from robogauntlet_mergevla.merging.recipe import Recipe


def test_a_recipe_reads_back_from_json():
    recipe = Recipe("dare", 0.5, "emr", {"a": 0.4}, "mean", 2, True, "select", {"drop": 0.5})
    assert Recipe.from_json(recipe.as_json()) == recipe
    with pytest.raises(OutOfRange, match="recipe for merging: operators: "):
        Recipe.from_json({"operators": "ties"})
    with pytest.raises(OutOfRange, match="expected lambda"):
        Recipe.from_json({"lambda_": 2.5})


@pytest.mark.parametrize(
    ("field", "value"),
    [("operator", ["ties"]), ("merge_output", "no"), ("options", 5), ("options", {1: 2}), ("masks", "some")],
)
def test_a_value_of_another_type_is_refused(field, value):
    with pytest.raises(OutOfRange, match=f"recipe for merging: {field}.*: expected"):
        Recipe.from_json({field: value})
