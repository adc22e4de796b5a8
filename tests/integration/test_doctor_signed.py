"""The doctor on a signed link, with a vehicle that speaks to nobody before it has heard a signed heartbeat."""

from __future__ import annotations

import asyncio
import time

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from signed_frames import heartbeat

from gcs_coloc.config.settings import Settings
from gcs_coloc.doctor.listen import listen
from gcs_coloc.runtime.clock import ServiceClock, read_host_clock

pytestmark = pytest.mark.integration

KEY = bytes(range(100, 132))


class SignedVehicle(asyncio.DatagramProtocol):
    """Takes what is signed with its key, and answers questions for GPS2_TYPE."""

    def __init__(self):
        self.mav = mavlink.MAVLink(None, srcSystem=4, srcComponent=1)
        ticks = int((time.time() - 1_420_070_400) * 1e5)
        self.mav.signing.secret_key, self.mav.signing.sign_outgoing, self.mav.signing.timestamp = KEY, True, ticks
        self.heard = mavlink.MAVLink(None)
        self.heard.robust_parsing = True
        self.heard.signing.secret_key, self.heard.signing.timestamp = KEY, ticks

    def connection_made(self, transport):
        self.transport = transport

    def datagram_received(self, data, addr):
        for message in self.heard.parse_buffer(data) or []:
            if message.get_type() == "HEARTBEAT":
                self.say(heartbeat(), addr)
            elif message.get_type() == "PARAM_REQUEST_READ" and message.param_id == "GPS2_TYPE":
                self.say(mavlink.MAVLink_param_value_message(b"GPS2_TYPE", 14.0, mavlink.MAV_PARAM_TYPE_INT8, 900, 1), addr)

    def say(self, message, addr):
        self.transport.sendto(bytes(message.pack(self.mav)), addr)
        self.mav.seq = (self.mav.seq + 1) & 0xFF


def examine(signing):
    async def look():
        loop = asyncio.get_running_loop()
        transport, _ = await loop.create_datagram_endpoint(SignedVehicle, local_addr=("127.0.0.1", 0))
        port = transport.get_extra_info("sockname")[1]
        settings = Settings(links=(f"udpout:127.0.0.1:{port}",), signing=signing)
        clock = ServiceClock()
        try:
            return await listen(settings, 4.0, clock, read_host_clock(clock()), lambda: None)
        finally:
            transport.close()

    return asyncio.run(look())


def test_with_the_key_a_signed_vehicle_answers_and_without_it_is_not_even_heard(tmp_path):
    key_file = tmp_path / "key"
    key_file.write_text(KEY.hex())
    key_file.chmod(0o600)
    (vehicle,) = examine({"key_file": str(key_file), "mode": "require"}).vehicles
    assert vehicle.is_signed
    assert vehicle.parameters == {"GPS2_TYPE": 14.0}
    assert vehicle.answers_only_to is None
    assert examine({}).vehicles == ()
