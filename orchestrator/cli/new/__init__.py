"""`robogauntlet new`: create the files of an adapter or of a policy, or record demonstrations."""
