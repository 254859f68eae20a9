"""Whatever is done to a run, giving the command again brings it to the same rows, and nothing is left behind."""

from concurrent.futures import ThreadPoolExecutor

import pytest

from tests.chaos.campaign import FAULTS, campaign, drawn_faults
from tests.chaos.suites import NULL, REAL

pytestmark = [pytest.mark.ray, pytest.mark.slow]
SEEDS = range(10)
AT_ONCE = 3


@pytest.fixture(scope="module")
def survived(tmp_path_factory):
    """A run that is left alone and ten under three faults each, some at the same time: they mostly wait."""
    folder = tmp_path_factory.mktemp("chaos")
    suite = folder / "suite.yaml"
    suite.write_text(NULL)

    def one(seed):
        faults = () if seed is None else drawn_faults(seed, 3)
        return campaign(suite, folder / f"run{seed}", seed or 0, faults=faults, gap_s=1.5)

    with ThreadPoolExecutor(AT_ONCE) as pool:
        return dict(zip((None, *SEEDS), pool.map(one, (None, *SEEDS)), strict=True))


def test_a_run_that_is_left_alone_ends_at_the_first_start(survived):
    assert (survived[None].starts, survived[None].problems) == (1, [])


@pytest.mark.parametrize("seed", SEEDS)
def test_nothing_is_lost_doubled_or_left_behind(survived, seed):
    assert survived[seed].problems == []
    assert survived[seed].rows_hash == survived[None].rows_hash


def test_every_kind_of_fault_came_up(survived):
    assert {fault for one in survived.values() for fault in one.faults} == FAULTS.keys()


@pytest.mark.simulator
def test_three_real_simulators_survive_the_death_of_worker_ray_and_scheduler(tmp_path):
    suite = tmp_path / "suite.yaml"
    suite.write_text(REAL)
    calm = tmp_path / "calm.yaml"
    calm.write_text(REAL.replace("workers: auto", "workers: 1"))
    faults = ("worker killed", "raylet killed", "scheduler killed")
    disturbed = campaign(suite, tmp_path / "disturbed", 0, faults=faults, gap_s=1.0)
    alone = campaign(calm, tmp_path / "alone", 0, faults=(), gap_s=1.0)
    assert (disturbed.problems, alone.problems) == ([], [])
    assert disturbed.starts == 2
    assert disturbed.rows_hash == alone.rows_hash
