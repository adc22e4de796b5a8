"""The registry of link schemes, and the reading of connection strings in the forms of MAVProxy and its kin.

A link scheme is one module and one line in `SCHEMES`: the module holds a class that implements `base.LinkAddress`, and the
link that this class makes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from importlib import import_module
from itertools import combinations
from typing import cast

from gcs_coloc.core.errors import UsageError
from gcs_coloc.links.base import LinkAddress, MalformedAddressError

SCHEMES: dict[str, tuple[str, str]] = {
    "udpin": ("gcs_coloc.links.udp", "UdpIn"),
    "udpout": ("gcs_coloc.links.udp", "UdpOut"),
    "tcp": ("gcs_coloc.links.tcp", "TcpClient"),
    "tcpin": ("gcs_coloc.links.tcp", "TcpServer"),
    "serial": ("gcs_coloc.links.serial", "SerialDevice"),
}
"""Module and address class of each scheme. A module is imported when its scheme is first used."""


def parse(text: str) -> LinkAddress:
    """Read a connection string of a vehicles' link. Raises UsageError that quotes it and shows the right forms."""
    return _parse(text, "udpin", "14550, HOST:PORT", "udpin:[::]:14550")


def parse_out(text: str) -> LinkAddress:
    """Read a ground tool's connection string: as `parse`, but `udp:` and a bare HOST:PORT are sent to, as MAVProxy's."""
    return _parse(text, "udpout", "HOST:PORT or udp:HOST:PORT (sent to that address)", "udp:[::1]:14551")


def parse_links(texts: Iterable[str]) -> list[LinkAddress]:
    """Read the connection strings of the vehicles' links. Raises UsageError where one is malformed, or two are the same place."""
    links = [parse(text) for text in texts]
    for one, other in combinations(links, 2):
        if one.is_same_place(other):
            both = f"{one} is given twice" if one == other else f"{one} and {other} are the same place"
            raise UsageError(f"{both}; leave one out")
    return links


def check_outs(outs: Sequence[str], links: Sequence[str]) -> None:
    """Check the connection strings of ground tools, and of the vehicles' links, before anything is opened.

    Raises:
        UsageError: one is malformed, given twice, or a tool's leads back to one of `links`, the vehicles'.
    """
    vehicles = parse_links(links)
    seen: set[LinkAddress] = set()
    for text in outs:
        out = parse_out(text)
        if out in seen:
            raise UsageError(f"out {text}: is given twice")
        seen.add(out)
        for link in vehicles:
            if out.leads_to(link):
                raise UsageError(
                    f"out {text}: leads back to the vehicles' link {link}; give the address where the ground tool is"
                )


def _parse(text: str, udp_scheme: str, bare_forms: str, ipv6_example: str) -> LinkAddress:
    """Read `text`. `udp_scheme` is the scheme of `udp:` and of a text without one; the rest is shown where it is malformed."""
    stripped = text.strip()
    scheme, colon, rest = stripped.partition(":")
    if stripped.startswith("/"):
        scheme, rest = "serial", stripped
    elif colon and scheme == "udp":
        scheme = udp_scheme
    elif not colon or scheme not in SCHEMES:
        scheme, rest = udp_scheme, stripped
    try:
        return _address_class(scheme).parse(rest)
    except MalformedAddressError as error:
        if error.args:
            raise UsageError(f"{text!r}: {error}") from None
        forms = ", ".join([bare_forms, *dict.fromkeys(_address_class(known).FORM for known in SCHEMES)])
        raise UsageError(
            f"{text!r} is no connection string; write {forms} (an IPv6 address in brackets: {ipv6_example})"
        ) from None


def _address_class(scheme: str) -> type[LinkAddress]:
    module, name = SCHEMES[scheme]
    return cast("type[LinkAddress]", getattr(import_module(module), name))
