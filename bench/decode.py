"""What a frame costs from bytes to the core's message, beside pymavlink and the mere finding of frames."""

from __future__ import annotations

import time

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from bench.figures import Figure, interleaved
from bench.traffic import Sent, fleet_traffic
from gcs_coloc.mavlink import framing
from gcs_coloc.mavlink.decoder import Decoder
from gcs_coloc.mavlink.refusals import Counts


def measure(quick: bool) -> list[Figure]:
    """Realistic traffic, datagram by datagram; CPU of this process."""
    traffic = fleet_traffic(5.0 if quick else 30.0)
    cost_us = interleaved(
        {"ours": lambda: _ours(traffic), "pymavlink": lambda: _pymavlink(traffic), "framing": lambda: _framing(traffic)}, 9
    )
    ratio = cost_us["pymavlink"] / cost_us["ours"]
    return [
        Figure(
            "a frame, to the core's message, duplicates and impossible values refused",
            f"{cost_us['ours']:.1f} us; pymavlink parse_buffer {cost_us['pymavlink']:.1f} us: {ratio:.1f} times as fast",
            "faster than pymavlink",
            ratio > 1.0,
        ),
        Figure("of which finding it and its checksum", f"{cost_us['framing']:.1f} us"),
    ]


def _ours(traffic: list[Sent]) -> float:
    decoder = Decoder()
    began_s = time.process_time()
    for at_s, sysid, payload in traffic:
        decoder.decode(payload, at_s, sysid)
    return (time.process_time() - began_s) / len(traffic) * 1e6


def _pymavlink(traffic: list[Sent]) -> float:
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True
    began_s = time.process_time()
    for _, _, payload in traffic:
        parser.parse_buffer(payload)
    return (time.process_time() - began_s) / len(traffic) * 1e6


def _framing(traffic: list[Sent]) -> float:
    counts = Counts()
    began_s = time.process_time()
    for _, _, payload in traffic:
        framing.split(payload, counts, ended=True)
    return (time.process_time() - began_s) / len(traffic) * 1e6
