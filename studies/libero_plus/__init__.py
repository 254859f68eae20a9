"""LIBERO's experts and their merges under the axes of LIBERO-Plus."""
