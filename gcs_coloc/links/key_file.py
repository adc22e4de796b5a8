"""Reading a signing key from a file that nobody else can read."""

from __future__ import annotations

import hashlib
import os
import stat
from pathlib import Path

from gcs_coloc.core.errors import ConfigError
from gcs_coloc.mavlink.signing import KEY_LENGTH

_MOST_BYTES = 4096


def read_key(path: Path) -> bytes:
    """Read the 32 bytes of a signing key.

    The file holds 64 hexadecimal digits; or else one line of text, a passphrase, whose SHA-256 (of the line in UTF-8 without
    its end) is the key, as Mission Planner and MAVProxy make it; or else the 32 bytes themselves.

    Raises:
        ConfigError: the file cannot be read, can be read by others than its owner, or holds no key.
    """
    content = _read_private(path)
    text = _line(content)
    if text is None:
        key = content
    elif len(text) == 2 * KEY_LENGTH and all(digit in "0123456789abcdefABCDEF" for digit in text):
        key = bytes.fromhex(text)
    else:
        key = hashlib.sha256(text.encode("utf-8")).digest()
    if len(key) != KEY_LENGTH:
        raise ConfigError(
            f"{path}: holds no signing key; wanted are 64 hexadecimal digits, a passphrase on one line, or {KEY_LENGTH} bytes"
        )
    if not any(key):
        raise ConfigError(f"{path}: a key of zeros means no signing in MAVLink; make one with: openssl rand -hex {KEY_LENGTH}")
    return key


def _read_private(path: Path) -> bytes:
    try:
        # O_NONBLOCK: a pipe in place of the file must not hold the program up.
        with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
            # Of the open file, not of the path: what is checked is what is read.
            mode = os.fstat(file.fileno()).st_mode
            if not stat.S_ISREG(mode):
                raise ConfigError(f"{path}: is no file")
            if mode & (stat.S_IRWXG | stat.S_IRWXO):
                raise ConfigError(
                    f"{path}: the signing key can be used by others (mode {stat.S_IMODE(mode):04o}); mend with: chmod 600 {path}"
                )
            return file.read(_MOST_BYTES)
    except OSError as error:
        raise ConfigError(f"{path}: the signing key cannot be read: {error.strerror}") from None


def _line(content: bytes) -> str | None:
    """The one line of text in a file, without its end; None where the file holds something else."""
    try:
        text = content.decode("utf-8").removesuffix("\n").removesuffix("\r")
    except UnicodeDecodeError:
        return None
    return text if text.isprintable() and text else None
