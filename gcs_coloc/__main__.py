"""`gcs-coloc` and `python -m gcs_coloc`: the command line."""

from __future__ import annotations

import signal


def main() -> None:
    """Entry point. Ctrl-C while Python still reads the packages ends it at once, and without a traceback."""
    is_heeded = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if is_heeded:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from gcs_coloc.runtime.process import collect_seldom

    collect_seldom()  # before the packages are read: nearly nothing that they make is garbage
    from gcs_coloc.cli import main as cli

    if is_heeded:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    cli.main()


if __name__ == "__main__":
    main()
