"""The run folder: written, read back and summed up; TensorBoard; checkpoints."""
