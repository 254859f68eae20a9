"""One local Ray for all tests that need one, and a record of what a scheduler tells."""

import pytest


@pytest.fixture(scope="session")
def ray_here():
    from orchestrator.cluster import ray_session

    with ray_session(address=None, workers=6):
        yield


class Told:
    """A scheduler's observer that remembers."""

    def __init__(self):
        self.ready, self.left_out, self.rows, self.troubles = [], [], [], []
        self.on_rows = lambda rows: None

    def started(self, simulator, readiness):
        self.ready.append((simulator, readiness))

    def skipped(self, simulator, reason, episodes):
        self.left_out.append((simulator, reason, episodes))

    def came(self, results):
        self.rows += results
        self.on_rows(results)

    def trouble(self, simulator, message):
        self.troubles.append(message)

    def tick(self, doing):
        pass


@pytest.fixture
def told():
    return Told()
