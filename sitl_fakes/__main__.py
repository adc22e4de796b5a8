"""`python -m sitl_fakes`: the command line."""

from sitl_fakes.cli import main

if __name__ == "__main__":
    main()
