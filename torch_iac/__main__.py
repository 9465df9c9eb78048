"""`python -m torch_iac` is the command `torch-iac`."""

from torch_iac.cli.main import main

main()
