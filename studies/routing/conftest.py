"""The model and its routers that the tests of `tests/mergevla/routing` have."""

from tests.mergevla.routing.conftest import model

__all__ = ["model"]
