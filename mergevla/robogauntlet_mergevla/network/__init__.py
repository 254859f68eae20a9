"""The network: backbone, LoRA, action expert, tokenizer, normalisation."""
