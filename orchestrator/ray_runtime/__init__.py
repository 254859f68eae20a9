"""Ray sessions, and generators that run in a process per simulator."""
