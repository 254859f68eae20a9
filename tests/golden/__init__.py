"""The golden record: small kept runs, and all that is derived from them.

`runs/KIND` has a suite, the document of its run and its rows, in forms that do not depend on the store's.
`records/KIND` has what came out of them: identities, reports, and what the verbs say. `python -m tests.golden` compares
today's tree with it and plays nothing. The rows of most kinds were played; those of `clean`, `combinations`, `libero`
and `robustness` are drawn.
"""
