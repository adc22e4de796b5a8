"""What time it is: the host's UTC where its clock is disciplined, else that of the vehicles whose GPS is healthy."""

from __future__ import annotations

from collections.abc import Iterable
from statistics import median

from gcs_coloc.core.clocks.gps_time import TABLE_GOOD_UNTIL, table_is_old
from gcs_coloc.core.gps_health.gps_health import GpsState
from gcs_coloc.core.messages.control import ClockReference
from gcs_coloc.core.messages.outbound import Notice
from gcs_coloc.core.telemetry.vehicles import Vehicle

_UNDISCIPLINED = "the host's clock is not synchronised (NTP or the like)"
_UNTOLD = "the host does not tell whether its clock is synchronised"


class Utc:
    """UTC on the service's clock. `required`: aid is withheld while the host's clock is not known to be synchronised."""

    def __init__(self, *, required: bool) -> None:
        self._required = required
        self._host: ClockReference | None = None
        self._warned_of_old_table = False

    def take(self, message: ClockReference) -> list[Notice]:
        """Take what the host says of its clock; returns what a person should read, once for each change."""
        before = self._host.synchronised if self._host is not None else None
        first, self._host = self._host is None, message
        out: list[Notice] = []
        if message.synchronised is not before or (first and self._required):
            out.extend(self._tell(message))
        offset_s = message.utc_minus_service_s
        if offset_s is not None and not self._warned_of_old_table and table_is_old(message.received_at_s + offset_s):
            self._warned_of_old_table = True
            text = f"the leap second table is good until {TABLE_GOOD_UNTIL:%Y-%m-%d} only: GPS time may be a second off, update"
            out.append(Notice(message.received_at_s, None, "warning", text))
        return out

    def withheld(self) -> str | None:
        """Why no aid may be sent, in words; None where it may."""
        if not self._required or (self._host is not None and self._host.synchronised):
            return None
        return _UNDISCIPLINED if self._host is not None and self._host.synchronised is False else _UNTOLD

    def minus_service_s(self, fleet: Iterable[Vehicle]) -> float | None:
        """UTC (UNIX seconds) minus service clock; None where neither host nor vehicles know.

        A clock that is known not to be synchronised counts less than what healthy vehicles have from their GPS (their median).
        """
        host_s = self._host.utc_minus_service_s if self._host is not None else None
        if host_s is not None and self._host is not None and self._host.synchronised is not False:
            return host_s
        told = [
            vehicle.utc_minus_service_s
            for vehicle in fleet
            if vehicle.utc_minus_service_s is not None and vehicle.health.state is GpsState.HEALTHY
        ]
        return median(told) if told else host_s

    def _tell(self, message: ClockReference) -> list[Notice]:
        if message.synchronised:
            return [Notice(message.received_at_s, None, "info", "the host's clock is synchronised")]
        if self._required:
            return [Notice(message.received_at_s, None, "error", f"{self.withheld()}: aid is withheld, as it is set")]
        if message.synchronised is False:
            text = f"{_UNDISCIPLINED}: the time in GPS_INPUT is the vehicles' where they know it, else it may be wrong"
            return [Notice(message.received_at_s, None, "warning", text)]
        return []
