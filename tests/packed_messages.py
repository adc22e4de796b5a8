"""Messages of a vehicle with plain values, packed by pymavlink's own generated code."""

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.mavlink._generated import gcs_coloc as ours

NOW_S = 12.5


UNIX_US = 1_700_000_000_250_000


def pack(message, sysid=1, compid=1, sequence=0, **kwargs):
    mav = mavlink.MAVLink(None, srcSystem=sysid, srcComponent=compid)
    mav.seq = sequence
    return message.pack(mav, **kwargs)


def heartbeat(kind=mavlink.MAV_TYPE_FIXED_WING, autopilot=mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, base_mode=0):
    return mavlink.MAVLink_heartbeat_message(kind, autopilot, base_mode, 0, 4, 3)


def global_position(**changes):
    fields = {"time_boot_ms": 61_250, "lat": -353_632_621, "lon": 1_491_652_374, "alt": 584_190, "relative_alt": 100}
    fields |= {"vx": 1500, "vy": -250, "vz": -30, "hdg": 35_000}
    return mavlink.MAVLink_global_position_int_message(**(fields | changes))


def gps_raw(**changes):
    fields = {
        "time_usec": UNIX_US,
        "fix_type": 6,
        "lat": -353_632_621,
        "lon": 1_491_652_374,
        "alt": 584_190,
        "eph": 121,
        "epv": 200,
    }
    fields |= {"vel": 2200, "cog": 0, "satellites_visible": 10, "h_acc": 300, "v_acc": 450, "vel_acc": 120}
    return mavlink.MAVLink_gps_raw_int_message(**(fields | changes))


def peer_range(**changes):
    fields = {"time_usec": 61_250_000, "range": 812.5, "range_std": 0.25, "sequence": 65_535, "peer_system": 3}
    fields |= {"quality": 80, "device_id": 2}
    return ours.MAVLink_peer_range_message(**(fields | changes))


def ranging_beacon(**changes):
    fields = {
        "time_usec": 61_250_000,
        "target_system": 0,
        "target_component": 0,
        "beacon_id": 3,
        "range": 812_500,
        "lat": 0x7FFFFFFF,
        "lon": 0x7FFFFFFF,
    }
    fields |= {
        "alt": math.nan,
        "alt_type": 0,
        "hacc_est": 0,
        "vacc_est": 0,
        "carrier_freq": 0,
        "range_accuracy": 250,
        "sequence": 200,
    }
    return ours.MAVLink_ranging_beacon_message(**(fields | {"status": 0} | changes))


def named_value(name=b"RNG3", value=812.5, boot_ms=61_250):
    return mavlink.MAVLink_named_value_float_message(boot_ms, name, value)


def debug_vect(name=b"RNG3", time_usec=61_250_000, x=812.5, y=0.25, z=80.0):
    return mavlink.MAVLink_debug_vect_message(name, time_usec, x, y, z)
