"""Signs of life on the wire: what comes out is what went in, and nothing that was not made with the key."""

from __future__ import annotations

import asyncio
import hmac
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.free_ports import free_port
from gcs_coloc.core.errors import LinkError
from gcs_coloc.core.messages.control import AidingOverride, GpsOverride, PrimaryOverride, SwitchedReceiver
from gcs_coloc.core.standby.sign_of_life import Identity, OverrideInForce, Shared, SignOfLife, StandbyState, Wish
from gcs_coloc.links.standby_link import StandbyLink, StandbyRefusal, pack, unpack
from gcs_coloc.runtime.clock import ServiceClock

KEY = bytes(range(32))
SIGN = SignOfLife(Identity(254, 191), 1, 2, 3, 4, StandbyState.ACTIVE, 5)
_IDS = st.integers(1, 2**32 - 1)
_NUMBERS = st.integers(0, 2**48)
_OVERRIDES = st.builds(OverrideInForce, _IDS, st.sampled_from([*GpsOverride, *AidingOverride, *PrimaryOverride]))
_SWITCHED = st.builds(SwitchedReceiver, _IDS, st.none(), st.none()) | st.builds(
    SwitchedReceiver, _IDS, st.floats(-1e6, 1e6), st.integers(1, 10)
)
SIGNS = st.builds(
    SignOfLife,
    st.builds(Identity, _IDS, st.integers(1, 255)),
    _NUMBERS,
    _NUMBERS,
    _NUMBERS,
    _NUMBERS,
    st.sampled_from(StandbyState),
    _NUMBERS,
    st.sampled_from(Wish),
    st.builds(
        Shared,
        st.lists(_IDS, max_size=5).map(tuple),
        st.lists(_OVERRIDES, max_size=5).map(tuple),
        st.lists(_SWITCHED, max_size=5).map(tuple),
    ),
)


@given(SIGNS)
def test_every_sign_of_life_comes_out_as_it_went_in(sign):
    assert unpack(pack(sign, KEY), KEY) == sign


@given(st.data())
def test_no_bit_can_be_changed(data):
    datagram = bytearray(pack(SIGN, KEY))
    at = data.draw(st.integers(0, len(datagram) - 1))
    datagram[at] ^= 1 << data.draw(st.integers(0, 7))
    assert unpack(bytes(datagram), KEY) is StandbyRefusal.WRONG_KEY


@pytest.mark.parametrize("datagram", [b"", b"hello", bytes(31), bytes(32), bytes(70_000), pack(SIGN, b""), pack(SIGN, bytes(32))])
def test_what_was_not_made_with_the_key_is_refused(datagram):
    assert unpack(datagram, KEY) is StandbyRefusal.WRONG_KEY


@given(
    st.recursive(st.none() | st.booleans() | st.integers() | st.text(), lambda of: st.lists(of) | st.dictionaries(st.text(), of))
)
def test_what_is_made_with_the_key_and_says_something_else_is_refused(content):
    body = json.dumps(content).encode()
    assert unpack(hmac.digest(KEY, body, "sha256") + body, KEY) is StandbyRefusal.OTHER_FORMAT


def test_two_links_hear_each_other_and_count_what_is_not_theirs():
    async def talk() -> tuple[SignOfLife, int]:
        clock, ports = ServiceClock(), (free_port(), free_port())
        heard: asyncio.Queue[SignOfLife] = asyncio.Queue()
        one = StandbyLink(("127.0.0.1", ports[1]), ("127.0.0.1", ports[0]), KEY, clock, heard.put_nowait)
        other = StandbyLink(("127.0.0.1", ports[0]), ("127.0.0.1", ports[1]), KEY, clock, lambda _: None)
        stranger = StandbyLink(("127.0.0.1", ports[0]), ("127.0.0.1", free_port()), bytes(32), clock, lambda _: None)
        for link in (one, other, stranger):
            await link.open()
        stranger.send(SIGN)
        other.send(SIGN)
        async with asyncio.timeout(20.0):
            sign = await heard.get()
        for link in (one, other, stranger):
            await link.close()
        return sign, one.counts[StandbyRefusal.WRONG_KEY]

    assert asyncio.run(talk()) == (SIGN, 1)


def test_a_host_that_is_not_found_is_named():
    link = StandbyLink(("no-such-host.invalid", 14590), ("127.0.0.1", free_port()), KEY, ServiceClock(), lambda _: None)

    async def open_it() -> None:
        try:
            await link.open()
        finally:
            await link.close()

    with pytest.raises(LinkError, match=r"standby\.peer: host 'no-such-host\.invalid' is not found"):
        asyncio.run(open_it())
