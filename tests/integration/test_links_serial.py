"""Serial links on a pseudo-terminal: the kernel's own serial device with a test at its other end."""

from __future__ import annotations

import asyncio
import itertools
import os
import tty

import pytest

from gcs_coloc.core.errors import LinkError
from gcs_coloc.links.serial import SerialDevice, SerialLink
from gcs_coloc.mavlink.encoder import Encoder
from tests.integration.link_peers import Inbox, heartbeat, until

pytestmark = pytest.mark.integration


class Radio:
    """The far end of a serial line; `plug` puts a device at the path, `unplug` takes it away."""

    def __init__(self, path):
        self.path = path
        self.plug()

    def plug(self):
        self.far_end, near_end = os.openpty()
        tty.setraw(near_end)
        os.set_blocking(self.far_end, False)
        self.path.symlink_to(os.ttyname(near_end))
        os.close(near_end)

    def unplug(self):
        self.path.unlink()
        os.close(self.far_end)

    def received(self):
        try:
            return os.read(self.far_end, 1 << 16)
        except BlockingIOError:
            return b""


@pytest.fixture
def radio(tmp_path):
    radio = Radio(tmp_path / "ttyRADIO")
    yield radio
    radio.unplug()


def serial_link(radio, inbox):
    return SerialLink(SerialDevice(str(radio.path), 57600), inbox, inbox.clock, delays=lambda: itertools.repeat(0.0))


def test_frames_go_both_ways(radio):
    async def scenario():
        inbox = Inbox()
        link = serial_link(radio, inbox)
        await link.open()
        stream = b"\x00noise" + heartbeat(1, 0) + heartbeat(1, 1)
        os.write(radio.far_end, stream[:13])
        os.write(radio.far_end, stream[13:])
        arrived = [await inbox.next(), await inbox.next()]
        assert [payload for _, _, payload, _ in arrived] == [heartbeat(1, 0), heartbeat(1, 1)]
        assert {address for _, address, _, _ in arrived} == {link.peers[0]} == {("serial", str(radio.path))}
        ours = Encoder().heartbeat(link.peers[0])
        link.send(link.peers[0], ours)
        got = bytearray()
        await until(lambda: got.extend(radio.received()) or len(got) >= len(ours))
        assert bytes(got) == ours
        await link.close()

    asyncio.run(scenario())


def test_bytes_that_look_like_terminal_controls_pass_unchanged(radio):
    """Every byte value, among them Ctrl-C, carriage return and XOFF, in frames either way."""

    async def scenario():
        inbox = Inbox()
        link = serial_link(radio, inbox)
        await link.open()
        frames = [heartbeat(1 + n % 255, n) for n in range(256)]
        for frame in frames:
            os.write(radio.far_end, frame)
            assert (await inbox.next())[2] == frame
            link.send(link.peers[0], frame)
            got = bytearray()
            await until(lambda got=got, frame=frame: got.extend(radio.received()) or len(got) >= len(frame))
            assert bytes(got) == frame
        await link.close()

    asyncio.run(scenario())


def test_device_that_takes_nothing_costs_neither_time_nor_memory(radio):
    async def scenario():
        link = serial_link(radio, Inbox())
        await link.open()
        frame = Encoder().heartbeat("x")
        for _ in range(20_000):
            link.send(link.peers[0], frame)
        assert link.counts["output_skipped"] > 0
        assert len(link._unsent) + link._outbox.size <= 1024 + len(frame)
        # Once the far end reads again, what was kept comes out whole.
        skipped = link.counts["output_skipped"]
        accepted = (20_000 - skipped) * len(frame)
        got = bytearray()
        await until(lambda: got.extend(radio.received()) or len(got) >= accepted)
        assert bytes(got) == frame * (20_000 - skipped)
        await link.close()

    asyncio.run(scenario())


def test_unplugged_device_is_opened_again_when_it_is_back(radio):
    async def scenario():
        inbox = Inbox()
        link = serial_link(radio, inbox)
        await link.open()
        os.write(radio.far_end, heartbeat(1, 0)[:9])
        radio.unplug()
        await until(lambda: link.counts["connection_lost"] == 1)
        link.send(link.peers[0], heartbeat(254))
        assert link.counts["not_connected"] == 1
        radio.plug()
        await until(lambda: link._port is not None)
        os.write(radio.far_end, heartbeat(1, 1))
        assert (await inbox.next())[2] == heartbeat(1, 1)
        await link.close()

    asyncio.run(scenario())


def test_device_that_does_not_exist_is_one_clear_line(tmp_path):
    link = SerialLink(SerialDevice(str(tmp_path / "ttyUSB7"), 57600), Inbox(), lambda: 0.0)
    with pytest.raises(LinkError) as raised:
        asyncio.run(link.open())
    assert str(raised.value) == f"{link.name}: there is no device {tmp_path}/ttyUSB7; is it plugged in?"


def test_file_that_is_no_serial_device_is_refused(tmp_path):
    path = tmp_path / "file"
    path.write_text("hello")
    link = SerialLink(SerialDevice(str(path), 57600), Inbox(), lambda: 0.0)
    with pytest.raises(LinkError, match="is no serial device"):
        asyncio.run(link.open())


def test_device_that_another_program_holds_is_refused(radio):
    async def scenario():
        first, second = serial_link(radio, Inbox()), serial_link(radio, Inbox())
        await first.open()
        with pytest.raises(LinkError, match="in use by another program"):
            await second.open()
        await first.close()

    asyncio.run(scenario())


def test_closing_twice_does_nothing(radio):
    async def scenario():
        link = serial_link(radio, Inbox())
        await link.close()
        await link.open()
        await link.close()
        await link.close()

    asyncio.run(scenario())
