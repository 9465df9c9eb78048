"""The command `torch-iac`."""
