"""A small merged model and routers that were fitted to its first observations."""

import pytest

from robogauntlet.policies.mergevla.routing.catalog import fit_routers
from tests.policies.mergevla.routing.synthetic import SmallMergedModel, frames


@pytest.fixture(scope="module")
def model():
    return SmallMergedModel()


@pytest.fixture(scope="module")
def stored(model):
    return fit_routers(model, frames(0, 8), frames(50, 6))
