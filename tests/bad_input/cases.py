"""All bad inputs."""

from tests.bad_input import (
    cases_arguments,
    cases_exported,
    cases_places,
    cases_policies,
    cases_runs,
    cases_search,
    cases_suites,
)

MODULES = (cases_arguments, cases_suites, cases_runs, cases_exported, cases_policies, cases_places, cases_search)
CASES = [case for module in MODULES for case in module.CASES]
