"""`python -m tiler` is the command `tiler`."""

from tiler.cli import main

main()
