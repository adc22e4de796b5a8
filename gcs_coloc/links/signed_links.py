"""How each link is signed, by the configuration."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from pathlib import Path

from gcs_coloc.config.sections import SigningConfig
from gcs_coloc.core.errors import ConfigError, UsageError
from gcs_coloc.links.address import parse, parse_out
from gcs_coloc.links.key_file import read_key
from gcs_coloc.mavlink.signing import FIRST_CONTACT_S, LinkSigning, Signing


class SignedLinks:
    """The signing of each of the links that are given by their connection strings; `outs` are those of ground tools.

    Raises:
        ConfigError: the key file is of no use, or the configuration signs a link that there is not.
    """

    def __init__(self, config: SigningConfig, links: Sequence[str], outs: Sequence[str] = ()) -> None:
        names = [*(str(parse(text)) for text in links), *(str(parse_out(text)) for text in outs)]
        modes: dict[str, str] = dict.fromkeys(names, config.mode)
        for text, mode in config.links.items():
            name = str(parse(text))
            if name not in modes:
                with contextlib.suppress(UsageError):  # such as a bare port, which is nobody's address
                    name = str(parse_out(text))
            if name not in modes:
                raise ConfigError(f"signing.links: {text} is none of the links: {', '.join(names) or 'there is none'}")
            modes[name] = mode
        self._signing = Signing(read_key(Path(config.key_file))) if config.key_file else None
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
        """Tell how far UNIX time is ahead of the service's clock; None: not known."""
        if self._signing is not None:
            self._signing.set_clock(unix_minus_service_s)

    def pending_warning(self, now_s: float) -> str | None:
        """That the time of signatures runs ahead of the host's clock, once each time that it comes to do so; None otherwise."""
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
