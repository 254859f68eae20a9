"""Statistics of episodes: pure functions of counts and outcomes, without a global random generator.

`rates` and `pairs` import numpy and scipy when they are called, so that importing them takes milliseconds.
"""
