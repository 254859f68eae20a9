"""Merging experts: pure functions on mappings of weight name to fp32 tensor, independent of any model class.

`taus` takes differences, `operators` merges them, `masks` chooses what each task keeps, `merged` does both at once,
`trunk` does it to action experts, and `diagnostics` says what came of it. No function modifies its arguments.
"""
