"""The dashboard: what runs, what came of it and what is due, as pages for a browser. Read-only but for uploads."""
