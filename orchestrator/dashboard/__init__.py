"""The dashboard: running suites, results and schedules as web pages, which only read."""
