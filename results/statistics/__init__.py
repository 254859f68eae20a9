"""Statistics of episodes: counts and outcomes in, frozen values out. No state, no global random generator.

What scipy has is used from there. `rates` and `pairs` import numpy and scipy when they are called, so that showing
numbers takes milliseconds to import.
"""
