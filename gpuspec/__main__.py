"""`python -m gpuspec` is the command `gpuspec`."""

from gpuspec.cli import main

main()
