"""`python -m gpuspec` is the command `gpuspec`."""

from gpuspec.cli.main import main

main()
