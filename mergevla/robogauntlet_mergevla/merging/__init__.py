"""Merging experts: pure functions on mappings of weight name to fp32 tensor, independent of any model class.

`task_vectors` takes differences, `elementwise` and `signs` merge them, `masks` chooses what each task
keeps, `merge` does both, `trunk` splits action experts, and `diagnostics` measures the result. No function modifies its
arguments.
"""
