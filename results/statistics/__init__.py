"""Statistics of episodes: counts and outcomes in, frozen values out. No state, no global random generator.

Whatever scipy or statsmodels has is theirs. `rates` and `pairs` load them when they are used, so that what only shows
numbers loads in milliseconds.
"""
