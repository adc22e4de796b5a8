"""`python -m sitl_fakes`: the same as `sitl-fakes`."""

from sitl_fakes.cli import main

main()
