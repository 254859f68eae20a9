"""The dashboard: running suites, results and schedules as web pages. Read-only except for uploads."""
