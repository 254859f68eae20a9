"""After any fault, resuming a run gives the same rows and leaves no process behind."""

from concurrent.futures import ThreadPoolExecutor

import pytest

from tests.chaos.campaign import draw_faults, run_campaign
from tests.chaos.suites import NULL

pytestmark = [pytest.mark.ray, pytest.mark.chaos]
RUNS, FAULTS_PER_RUN = 2, 4
"""Each of the eight kinds of faults occurs once; `python -m tests.chaos` does fifty runs."""
PARALLEL = 3


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """An undisturbed run, and runs under faults. Some run in parallel, because they mostly wait."""
    folder = tmp_path_factory.mktemp("chaos")
    suite = folder / "suite.yaml"
    suite.write_text(NULL.replace("count: 120", "count: 80"))
    faults = draw_faults(0, RUNS * FAULTS_PER_RUN)

    def run(number):
        its_faults = () if number is None else faults[number::RUNS]
        return run_campaign(suite, folder / f"run{number}", number or 0, faults=its_faults, gap_s=1.5)

    with ThreadPoolExecutor(PARALLEL) as pool:
        numbers = (None, *range(RUNS))
        return dict(zip(numbers, pool.map(run, numbers), strict=True))


def test_an_undisturbed_run_needs_one_start(results):
    assert (results[None].starts, results[None].problems) == (1, [])


@pytest.mark.parametrize("number", range(RUNS))
def test_no_episode_is_lost_or_duplicate_and_no_process_remains(results, number):
    assert results[number].problems == []
    assert results[number].rows_hash == results[None].rows_hash
