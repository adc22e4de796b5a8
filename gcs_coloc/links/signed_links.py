"""Signing of links: which of them are signed, by the settings, and the key from its file."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol

from gcs_coloc.core.errors import ConfigError, UsageError
from gcs_coloc.links.base import parse, parse_out
from gcs_coloc.mavlink.signing import FIRST_CONTACT_S, KEY_LENGTH, LinkSigning, Signing
from gcs_coloc.runtime.process import read_private_file


class SigningSettings(Protocol):
    """What the settings say about signing; the configuration's section `[signing]` is one."""

    @property
    def key_file(self) -> str:
        """The file of the secret key; empty: no signing."""

    @property
    def mode(self) -> str:
        """Of every link that is not in `links`: require, accept, off."""

    @property
    def links(self) -> Mapping[str, str]:
        """The mode of single links, by connection string."""


class SignedLinks:
    """The signing of each link, by connection string.

    `links` are the vehicles', `outs` those of ground tools.

    Raises:
        ConfigError: the key file is of no use, or the configuration signs a link that does not exist.
    """

    def __init__(self, settings: SigningSettings, links: Sequence[str], outs: Sequence[str] = ()) -> None:
        names = [*(str(parse(text)) for text in links), *(str(parse_out(text)) for text in outs)]
        modes: dict[str, str] = dict.fromkeys(names, settings.mode)
        for text, mode in settings.links.items():
            name = str(parse(text))
            if name not in modes:
                with contextlib.suppress(UsageError):  # such as a bare port, which is nobody's address
                    name = str(parse_out(text))
            if name not in modes:
                raise ConfigError(f"signing.links: {text} is none of the links: {', '.join(names) or 'there is none'}")
            modes[name] = mode
        self._signing = Signing(read_key(Path(settings.key_file))) if settings.key_file else None
        self._of: dict[str, LinkSigning] = {}
        self._warned_ahead = False
        if self._signing is not None:
            self._of = {
                name: LinkSigning(self._signing, number & 0xFF, required=modes[name] == "require")
                for number, name in enumerate(names)
                if modes[name] != "off"
            }

    def of(self, link: str) -> LinkSigning | None:
        """The signing of the link of that name; None where it is not signed."""
        return self._of.get(link)

    def set_clock(self, unix_minus_service_s: float | None) -> None:
        """Set how far UNIX time is ahead of the service's clock, s; None: not known."""
        if self._signing is not None:
            self._signing.set_clock(unix_minus_service_s)

    def pending_warning(self, now_s: float) -> str | None:
        """Return a warning when the time of signatures begins to run ahead of the host's clock.

        None where it does not, or where the warning was given already.
        """
        ahead_s = self._signing.ahead_s(now_s) if self._signing is not None else 0.0
        was_warned, self._warned_ahead = self._warned_ahead, ahead_s > FIRST_CONTACT_S
        if was_warned or not self._warned_ahead:
            return None
        return (
            f"the time of signatures is {_length(ahead_s)} ahead of this computer's clock: that of somebody who has the key, or "
            "this one, was or is wrong, and by MAVLink's rules it never runs back. A vehicle that is not heard yet is refused "
            "(signature_old) until it has heard us; set the clocks right, and start again where it cannot hear us"
        )


def _length(seconds: float) -> str:
    """A length of time in the unit that suits it."""
    for unit, unit_s in (("days", 86400.0), ("hours", 3600.0)):
        if seconds >= 2.0 * unit_s:
            return f"{seconds / unit_s:.0f} {unit}"
    return f"{seconds / 60.0:.0f} minutes"


def read_key(path: Path) -> bytes:
    """Read the 32 bytes of a signing key.

    The file holds 64 hexadecimal digits; or else one line of text, a passphrase, whose SHA-256 (of the line in UTF-8 without
    its end) is the key, as Mission Planner and MAVProxy make it; or else the 32 bytes themselves.

    Raises:
        ConfigError: the file cannot be read, can be read by others than its owner, or holds no key.
    """
    content = read_private_file(path, "the signing key")
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


def _line(content: bytes) -> str | None:
    """The one line of text in a file, without its end; None where the file holds something else."""
    try:
        text = content.decode("utf-8").removesuffix("\n").removesuffix("\r")
    except UnicodeDecodeError:
        return None
    return text if text.isprintable() and text else None
