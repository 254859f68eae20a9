"""Planted defects: whether comparisons, the gate, the searches and the check of policies find them."""
