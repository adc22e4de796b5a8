"""`sitl-fakes` and `python -m sitl_fakes`."""

from __future__ import annotations

import signal


def main() -> None:
    """Entry point. Ctrl-C while Python reads the packages, or ends, ends it without a traceback."""
    is_heeded = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if is_heeded:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from sitl_fakes import cli

    if is_heeded:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        cli.main()
    finally:
        if is_heeded:  # once more while Python ends
            signal.signal(signal.SIGINT, signal.SIG_DFL)


if __name__ == "__main__":
    main()
