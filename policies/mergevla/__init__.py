"""MergeVLA: a vision-language-action policy that can be merged (arXiv 2511.18810)."""
