"""MergeVLA (arXiv 2511.18810): experts fine-tuned by LoRA that can be merged into one model."""
