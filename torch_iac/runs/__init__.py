"""The run folder: writing, reading and summary; TensorBoard; checkpoints."""
