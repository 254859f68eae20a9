"""Studies made with RoboGauntlet: what was asked, how it was measured, the rows and the tables."""
