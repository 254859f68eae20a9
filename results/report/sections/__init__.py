"""The sections of a report, a file each; `section.py` has their order."""
