"""A merged model and routers fitted to it, which the tests share."""

import pytest

from robogauntlet_mergevla.routing.catalog import fit_routers
from tests.mergevla.routing.synthetic import SmallMergedModel, frames


@pytest.fixture(scope="session")
def model():
    return SmallMergedModel()


@pytest.fixture(scope="session")
def stored(model):
    """The tensors of all fitted routers."""
    return fit_routers(model, frames(0, 8), frames(50, 6))
