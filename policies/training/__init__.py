"""Training data: data sets of demonstrations, written and read. Nothing here trains."""
