"""`python -m torch_iac` is the command `torch-iac`."""

from torch_iac.command import main

main()
