"""`gcs-coloc` and `python -m gcs_coloc`: the command line."""

from __future__ import annotations

import signal


def main() -> None:
    """Entry point. Ctrl-C while Python reads the packages, or ends, ends it without a traceback."""
    is_heeded = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if is_heeded:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from gcs_coloc.runtime.process import collect_seldom

    collect_seldom()  # before the packages are read: nearly nothing that they make is garbage
    from gcs_coloc.cli import main as cli

    if is_heeded:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        cli.main()
    finally:
        if is_heeded:  # once more while Python ends
            signal.signal(signal.SIGINT, signal.SIG_DFL)


if __name__ == "__main__":
    main()
