"""The fleet on a real mosquitto that is killed, stopped and started again, while the service flies on."""

from __future__ import annotations

import json
import math
import signal
import socket
import time

import paho.mqtt.client as paho
import pytest
from brokers import PASSWORD, USER, Broker, certificate_for, wait_until
from vehicles import LAT, LON, M_PER_DEG_LAT, M_PER_DEG_LON, fly, square_fleet

from bench.free_ports import free_port as free_port_of

pytestmark = pytest.mark.integration

BASE = "gcs-coloc/v2/test"


class Observer:
    """A client that collects everything on the broker: the newest by topic, and all in order."""

    def __init__(self, port):
        self.newest, self.all, self.retained = {}, [], set()
        self.client = paho.Client(paho.CallbackAPIVersion.VERSION2)
        self.client.username_pw_set(USER, PASSWORD)
        self.client.on_connect = lambda client, *_: client.subscribe(f"{BASE}/#")
        self.client.on_message = self._take
        self.client.connect("127.0.0.1", port)
        self.client.loop_start()

    def _take(self, _client, _data, message):
        content = json.loads(message.payload)
        topic = message.topic.removeprefix(f"{BASE}/")
        self.newest[topic] = (content, message.retain)
        self.all.append((topic, content))
        if message.retain:
            self.retained.add(topic)

    def of(self, topic, field):
        return self.newest.get(topic, ({}, False))[0].get(field)

    def publish(self, topic, content):
        self.client.publish(f"{BASE}/{topic}", json.dumps(content))

    def close(self):
        self.client.disconnect()
        self.client.loop_stop()


@pytest.fixture
def broker(tmp_path):
    found = Broker(tmp_path, free_port_of(socket.SOCK_STREAM))
    found.start()
    yield found
    found.kill()


@pytest.fixture
def observe(broker):
    observers = []

    def start():
        observers.append(Observer(broker.port))
        return observers[-1]

    yield start
    for observer in observers:
        observer.close()


@pytest.fixture
def start_with_broker(start_service, broker, free_port, tmp_path):
    def start(*, password=PASSWORD, more=""):
        secret, config = tmp_path / "password", tmp_path / "coloc.toml"
        secret.write_text(password + "\n")
        secret.chmod(0o600)
        config.write_text(
            f'[web]\non = false\n[mqtt]\nhost = "127.0.0.1"\nport = {broker.port}\nusername = "{USER}"\n'
            f'password_file = "{secret}"\nfleet = "test"\npublish_hz = 5.0\n{more}'
        )
        return start_service("--udp", f"127.0.0.1:{free_port}", "--config", str(config))

    return start


def fixes(vehicle):
    return sum(m.fix_type == 3 for m in vehicle.of("GPS_INPUT"))


def test_the_latest_is_retained_and_back_after_the_broker_was_killed(start_with_broker, broker, observe, free_port):
    service = start_with_broker()
    first = observe()
    with square_fleet(free_port) as fleet:
        fly(fleet, 1.5)
        fly(fleet, 60.0, failed=[4], until=lambda: fixes(fleet[3]) >= 10 and first.of("4/state", "aiding_has_fix"))
        assert (first.of("4/health", "gps_state"), first.of("1/health", "gps_state")) == ("failed", "healthy")
        assert (first.of("status", "online"), first.of("status", "vehicles")) == (True, [1, 2, 3, 4])
        e, n, _ = fleet[3].enu_m
        north_m = (first.of("4/estimate", "lat_deg") - LAT) * M_PER_DEG_LAT - n
        east_m = (first.of("4/estimate", "lon_deg") - LON) * M_PER_DEG_LON - e
        assert math.hypot(north_m, east_m) < 4.0
        assert abs(first.of("4/estimate", "at_unix_s") - time.time()) < 60.0

        def is_alarm_raised() -> bool:
            return any(t == "alarms" and c["sysid"] == 4 and c["kind"] == "gps_lost" for t, c in first.all)

        fly(fleet, 60.0, failed=[4], until=is_alarm_raised)
        assert is_alarm_raised()

        broker.kill()
        before = fixes(fleet[3])
        fly(fleet, 3.0, failed=[4])
        assert fixes(fleet[3]) - before >= 20  # of 30; a service that waits for the broker sends none
        broker.start()
        late = observe()
        fly(fleet, 60.0, failed=[4], until=lambda: late.of("status", "online") is True and "4/estimate" in late.newest)
        # A client that comes later gets the state at once.
        latest = observe()
        retained = {"status", "4/state", "4/estimate", "4/health", "1/state", "1/estimate", "1/health"}
        fly(fleet, 60.0, failed=[4], until=lambda: retained <= latest.retained)
        assert retained <= latest.retained
        assert late.of("4/health", "gps_state") == "failed"
    service.send_signal(signal.SIGTERM)
    assert service.wait(60) == 0
    wait_until(lambda: late.of("status", "online") is False)


def test_the_last_will_tells_that_the_service_was_killed(start_with_broker, observe):
    service = start_with_broker()
    watching = observe()
    wait_until(lambda: watching.of("status", "online") is True)
    service.kill()
    wait_until(lambda: watching.of("status", "online") is False)
    later = observe()
    wait_until(lambda: "status" in later.newest)
    content, retained = later.newest["status"]
    assert (content["online"], retained) == (False, True)


def test_a_broker_that_hangs_delays_nothing_and_the_end_neither(start_with_broker, broker, observe, free_port):
    service = start_with_broker()
    watching = observe()
    with square_fleet(free_port) as fleet:
        fly(fleet, 1.5)
        fly(fleet, 60.0, failed=[4], until=lambda: fixes(fleet[3]) >= 10 and watching.of("status", "online"))
        broker.signal(signal.SIGSTOP)
        try:
            before = fixes(fleet[3])
            fly(fleet, 4.0, failed=[4])
            assert fixes(fleet[3]) - before >= 28  # of 40
            service.send_signal(signal.SIGTERM)
            fly(fleet, 60.0, failed=[4], until=lambda: service.poll() is not None)
            assert service.poll() == 0
            assert fleet[3].of("GPS_INPUT")[-1].fix_type == 1
        finally:
            broker.signal(signal.SIGCONT)


def test_a_broker_that_hangs_is_told_and_not_again_and_again(start_with_broker, broker, observe, free_port):
    service = start_with_broker()
    watching = observe()
    with square_fleet(free_port) as fleet:
        fly(fleet, 60.0, until=lambda: watching.of("status", "online"))
        broker.signal(signal.SIGSTOP)
        try:
            # The client notices after its keepalive of 10 s, and then fails to connect again and again.
            fly(fleet, 45.0)
            service.send_signal(signal.SIGTERM)
            fly(fleet, 60.0, until=lambda: service.poll() is not None)
            assert service.poll() == 0
        finally:
            broker.signal(signal.SIGCONT)
    told = [line for line in service.stderr.read().splitlines() if "mqtt: broker" in line]
    assert 1 <= len(told) <= 2, told
    assert all("trying again, the flight goes on without it" in line for line in told)


def test_commands_are_applied_only_where_they_are_allowed(start_with_broker, observe, free_port):
    service = start_with_broker()
    operator = observe()
    with square_fleet(free_port) as fleet:
        fly(fleet, 60.0, until=lambda: operator.of("1/health", "gps_state") == "healthy")
        operator.publish("1/cmd", {"gps": "failed"})
        fly(fleet, 1.0)
        assert (operator.of("1/health", "gps_state"), operator.of("1/health", "gps_override")) == ("healthy", "auto")
        service.send_signal(signal.SIGTERM)
        service.communicate(timeout=60)
        operator.newest.clear()

        start_with_broker(more="commands = true\n")
        fly(fleet, 60.0, until=lambda: operator.of("1/health", "gps_state") == "healthy")
        operator.publish("1/cmd", {"gps": "failed"})
        operator.publish("2/cmd", {"gps": "nonsense"})
        fly(fleet, 60.0, until=lambda: operator.of("1/health", "gps_state") == "failed" and operator.of("status", "refused"))
        assert operator.of("1/health", "gps_override") == "failed"
        assert operator.of("2/health", "gps_override") == "auto"
        assert operator.of("status", "refused").get("mqtt_cmd_invalid") == 1


def test_ranges_from_a_gateway_locate_a_vehicle(start_with_broker, observe, free_port):
    start_with_broker(more="ranges = true\n")
    gateway = observe()
    with square_fleet(free_port) as fleet:
        lost = fleet[3]
        lost.range_to = lambda other: b""  # it has no MAVLink ranges: they come over MQTT only

        def measure():
            for other in fleet[:3]:
                range_m = math.dist(lost.enu_m, other.enu_m)
                gateway.publish("4/range", {"peer": other.sysid, "range_m": range_m, "sigma_m": 0.5, "unix_s": time.time()})
            return fixes(lost) >= 15

        fly(fleet, 1.5)
        fly(fleet, 60.0, failed=[4], until=measure)
        assert fixes(lost) >= 15
        fix = [m for m in lost.of("GPS_INPUT") if m.fix_type == 3][-1]
        east, north = (fix.lon / 1e7 - LON) * M_PER_DEG_LON, (fix.lat / 1e7 - LAT) * M_PER_DEG_LAT
        assert math.hypot(east - lost.enu_m[0], north - lost.enu_m[1]) < 4.0


def test_readiness_follows_the_ranges_of_a_healthy_vehicle_and_is_retained(start_with_broker, observe, free_port):
    start_with_broker(more="ranges = true\n")
    gateway = observe()

    with square_fleet(free_port) as fleet:

        def is_ready() -> bool:
            for other in fleet[:3]:
                range_m = math.dist(fleet[3].enu_m, other.enu_m)
                gateway.publish("4/range", {"peer": other.sysid, "range_m": range_m, "sigma_m": 0.5, "unix_s": time.time()})
            return gateway.of("4/readiness", "state") == "ready" and gateway.of("1/readiness", "state") == "not_ready"

        fly(fleet, 90.0, until=is_ready)
        assert is_ready()
        assert gateway.of("4/readiness", "peers") == 3
        assert 0.0 < gateway.of("4/readiness", "bound_95_m") < gateway.of("4/readiness", "hpl_m") < 50.0
        assert (gateway.of("1/readiness", "reason"), gateway.of("1/readiness", "text")) == ("one_peer", "one peer ranged: 4")
        late = observe()
        fly(fleet, 60.0, until=lambda: "4/readiness" in late.retained)
        assert "4/readiness" in late.retained


def test_a_broker_that_refuses_us_is_told_once_and_the_flight_goes_on(start_with_broker, free_port):
    service = start_with_broker(password="not-it-x7q")
    with square_fleet(free_port) as fleet:
        fly(fleet, 1.5)
        fly(fleet, 60.0, failed=[4], until=lambda: fixes(fleet[3]) >= 5)
        assert fixes(fleet[3]) >= 5
    service.send_signal(signal.SIGTERM)
    _, log = service.communicate(timeout=60)
    told = [line for line in log.splitlines() if "mqtt" in line]
    assert len(told) == 1, log
    assert "the flight goes on without it" in told[0]
    assert "not-it-x7q" not in log


@pytest.mark.parametrize(("name", "words"), [("127.0.0.1", "connected to"), ("127.0.0.9", "certificate verify failed")])
def test_tls_is_spoken_with_the_broker_whose_name_is_on_the_certificate_and_no_other(
    start_service, free_port, tmp_path, name, words
):
    certificate = certificate_for(name, tmp_path)
    broker = Broker(tmp_path, free_port_of(socket.SOCK_STREAM), certificate)
    broker.start()
    try:
        secret, config = tmp_path / "password", tmp_path / "coloc.toml"
        secret.write_text(PASSWORD)
        secret.chmod(0o600)
        config.write_text(
            f'[web]\non = false\n[mqtt]\nhost = "127.0.0.1"\nport = {broker.port}\ntls = true\nca_file = "{certificate[0]}"\n'
            f'username = "{USER}"\npassword_file = "{secret}"\n'
        )
        service = start_service("--udp", f"127.0.0.1:{free_port}", "--config", str(config))
        line = next(line for line in service.stderr if "mqtt" in line)
        assert words in line
    finally:
        broker.kill()
