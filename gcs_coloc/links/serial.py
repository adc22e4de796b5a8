"""Scheme `serial`: a serial device, read and written without blocking.

A device that was unplugged is opened again when it is back.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import os
import re
import termios
from dataclasses import dataclass
from typing import Any, Self

import serial

from gcs_coloc.core.errors import LinkError
from gcs_coloc.links.base import MAX_UNSENT_BYTES, Address, Clock, DatagramHandler, LinkAddress, MalformedAddressError
from gcs_coloc.links.transport import FrameSource, Outbox, StreamLink
from gcs_coloc.mavlink.refusals import Refusal

DEFAULT_BAUD = 57600
"""The factory setting of SiK telemetry radios, and of SERIAL1_BAUD in ArduPilot."""
READ_BYTES = 4096
"""Chosen: more than a radio at 921600 baud delivers in 40 ms, so one read empties the system's buffer."""

_DEVICE = re.compile(r"(?P<device>/[^,\s]*?)(?:[:,](?P<baud>[0-9]{1,8}))?", re.ASCII)
_DEVICE_ERRORS = (OSError, ValueError, termios.error)  # pyserial's own is an OSError; a speed that does not exist, a ValueError

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SerialDevice(LinkAddress):
    """A serial device, such as a telemetry radio, and its speed."""

    FORM = "serial:/dev/ttyUSB0:57600"

    device: str
    baud: int

    def __str__(self) -> str:
        return f"serial:{self.device}:{self.baud}"

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read DEVICE, DEVICE:BAUD or DEVICE,BAUD; DEVICE is a path."""
        matched = _DEVICE.fullmatch(text)
        if matched is None:
            raise MalformedAddressError
        baud = int(matched["baud"]) if matched["baud"] else DEFAULT_BAUD
        if baud == 0:
            raise MalformedAddressError("a serial device cannot run at 0 baud")
        return cls(matched["device"], baud)

    @property
    def opening(self) -> str:
        """Listening."""
        return f"listening on {self}"

    def is_same_place(self, other: LinkAddress) -> bool:
        """The same device, at whatever speed."""
        return isinstance(other, SerialDevice) and self.device == other.device

    def leads_to(self, link: LinkAddress) -> bool:
        """The same device."""
        return self.is_same_place(link)

    def make_link(self, handler: DatagramHandler, clock: Clock, *, most_unsent_bytes: int = MAX_UNSENT_BYTES) -> SerialLink:
        """Make the link."""
        return SerialLink(self, handler, clock, most_unsent_bytes=most_unsent_bytes)


class SerialLink(StreamLink):
    """A serial device such as a telemetry radio.

    All vehicles behind it have one address, the one of `peers`.
    """

    def __init__(self, address: SerialDevice, *settings: Any, **further: Any) -> None:
        super().__init__(address, *settings, **further)
        self._far_end: Address = ("serial", address.device)
        self._address = address
        self._port: serial.Serial | None = None
        self._fd = -1
        self._source = FrameSource(self, self._far_end, self.handler, self.clock)
        self._unsent = b""  # the rest of the payload that is being written
        self._outbox = Outbox(self.counts, self.most_unsent_bytes)
        self._lost = asyncio.Event()

    @property
    def peers(self) -> tuple[Address, ...]:
        """Whoever is at the far end."""
        return (self._far_end,)

    async def open(self) -> None:
        """Open the device.

        LinkError where it does not exist, is in use, may not be opened or has no such speed.
        """
        try:
            self._start()
        except _DEVICE_ERRORS as error:
            raise LinkError(f"{self.name}: {self._cannot_open(error)}") from error
        self._keep(self._stay_open())

    def _cannot_open(self, error: Exception) -> str:
        number = getattr(error, "errno", None)
        if number is None and isinstance(error.__context__, termios.error):
            number = error.__context__.args[0]  # pyserial's own error has but the text of it
        device = self._address.device
        if number == errno.ENOENT:
            return f"there is no device {device}; is it plugged in?"
        if number == errno.EACCES:
            return f"no permission to open {device}; add yourself to its group (often: sudo usermod -aG dialout $USER)"
        if number == errno.EWOULDBLOCK:
            return f"{device} is in use by another program; stop that"
        if number in (errno.ENOTTY, errno.EISDIR, errno.ENODEV, errno.ENXIO):
            return f"{device} is no serial device; name the radio's, such as /dev/ttyUSB0 (ls /dev/serial/by-id shows them)"
        return f"{device} cannot be opened as a serial device: {error}"

    def _start(self) -> None:
        # Exclusive: two programs that read one device each get half of every frame.
        self._port = serial.Serial(self._address.device, self._address.baud, timeout=0, exclusive=True)
        self._fd = self._port.fileno()
        self._unsent = b""
        self._outbox.clear()
        self._lost.clear()
        asyncio.get_running_loop().add_reader(self._fd, self._read)

    def _stop(self) -> None:
        if self._port is None:
            return
        loop = asyncio.get_running_loop()
        loop.remove_reader(self._fd)
        loop.remove_writer(self._fd)
        with contextlib.suppress(*_DEVICE_ERRORS):  # the device may be gone already
            self._port.close()
        self._port = None
        self._lost.set()

    async def _stay_open(self) -> None:
        while True:
            await self._lost.wait()
            self.counts.add(Refusal.CONNECTION_LOST)
            log.warning("%s: device lost, opening it again when it is back", self.name)
            for delay_s in self.delays():
                await asyncio.sleep(delay_s)
                try:
                    self._start()
                except _DEVICE_ERRORS as error:
                    log.debug("%s: %s", self.name, self._cannot_open(error))
                else:
                    log.info("%s: device is back", self.name)
                    break

    def _read(self) -> None:
        try:
            data = os.read(self._fd, READ_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if data:
            self._source.feed(data)
        else:
            self._stop()

    def send(self, address: Address, payload: bytes, *, forwarded: bool = False) -> None:
        """Send frames, or keep them while the device has not accepted what came before."""
        if self._port is None or address != self._far_end:
            self.counts.add(Refusal.NOT_CONNECTED)
            return
        self._outbox.put(payload, forwarded=forwarded)
        if not self._unsent:
            self._write()

    def _write(self) -> None:
        unsent: bytes | None = self._unsent or self._outbox.pop()
        while unsent:
            try:
                unsent = unsent[os.write(self._fd, unsent) :] or self._outbox.pop()
            except BlockingIOError:
                break
            except OSError:
                self._stop()
                return
        self._unsent = unsent or b""
        loop = asyncio.get_running_loop()
        if self._unsent:
            loop.add_writer(self._fd, self._write)
        else:
            loop.remove_writer(self._fd)

    async def close(self) -> None:
        """Close the device and stay so."""
        await self._keep_no_longer()
        self._stop()
