"""Who acts: controls, scripted oracles and, later, learned policies behind one contract."""
