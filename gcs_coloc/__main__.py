"""`python -m gcs_coloc`: the command line."""

from gcs_coloc.cli import main

if __name__ == "__main__":
    main()
