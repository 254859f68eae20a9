"""MergeVLA (arXiv 2511.18810): experts, their merging into one policy, and inferring the task unaided."""
