"""Episode rows and the history of runs, in SQLite or PostgreSQL."""
