"""What the tests of measurements share: a builder with clocks of its own, a vehicle and its messages."""

from gcs_coloc.core.clocks.fleet_clocks import FleetClocks
from gcs_coloc.core.clocks.vehicle_clocks import TimeSettings
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import AttitudeMeasurement, Measurement, RangeMeasurement
from gcs_coloc.core.messages.inbound import Attitude, GlobalPosition, GpsReceiver, PeerRange, TimeBase
from gcs_coloc.core.telemetry.measurement_builder import MeasurementBuilder
from gcs_coloc.core.telemetry.measurement_settings import MeasurementSettings
from gcs_coloc.core.telemetry.reported_state import ReportedState


class Builder(MeasurementBuilder):
    """A builder with clocks of its own, its results unpacked."""

    def __init__(
        self, time: TimeSettings | None = None, settings: MeasurementSettings | None = None, *, has_frame: bool = False
    ) -> None:
        self.clocks = FleetClocks(time)
        super().__init__(settings or MeasurementSettings(), self.clocks)
        if has_frame:
            self.frame = LocalFrame(47.0, 8.0, 500.0)

    def measure(self, message: GlobalPosition, record: ReportedState, trusted: bool = True, **known) -> Measurement | None:
        built = self.position(message, record, is_trusted=trusted, **known)
        return built.measurement if built is not None else None

    def measure_range(self, message: PeerRange, record: ReportedState, peer: ReportedState) -> RangeMeasurement | None:
        return self.range(message, record, peer).measurement

    def measure_attitude(self, message: Attitude, record: ReportedState) -> AttitudeMeasurement | None:
        """As the dispatch does: the reported state holds the message already."""
        if not record.repeated_attitudes.add(message):
            record.attitude = message
        return self.attitude(message, record)


def vehicle(sysid: int = 4) -> ReportedState:
    return ReportedState(sysid, 0.0, 0.0)


def position(at_s: float, alt_m: float = 530.0, boot_s: float | None = None) -> GlobalPosition:
    return GlobalPosition(4, at_s, at_s if boot_s is None else boot_s, 47.1, 8.0, alt_m, 1.0, 2.0, 3.0)


def gps(h_acc_m: float | None, v_acc_m: float | None = None) -> GpsReceiver:
    return GpsReceiver(4, 0.0, 0, 3, 47.0, 8.0, 530.0, 9, 1.0, h_acc_m, v_acc_m, None)


def range_message(at_s: float, stamp_s: float | None, base: TimeBase, device: int = 0) -> PeerRange:
    return PeerRange(4, at_s, 1, 100.0, 0.5, stamp_s, base, 1, None, device)
