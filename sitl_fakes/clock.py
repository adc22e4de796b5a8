"""A vehicle's own clock: where it stood at the start, how fast it drifts, and what a reboot does to it."""

from __future__ import annotations


class BootClock:
    """Seconds since the vehicle's boot, as the vehicle itself counts them."""

    def __init__(self, offset_s: float, drift_ppm: float) -> None:
        self._zero_at_s = 0.0
        self._offset_s = offset_s
        self._rate = 1.0 + drift_ppm * 1e-6

    def boot_s(self, at_s: float) -> float:
        """Boot time (s) at a time of the simulation (s)."""
        return self._offset_s + (at_s - self._zero_at_s) * self._rate

    def jump(self, by_s: float) -> None:
        """Step by a time (s), forwards or back, as a clock does that is set."""
        self._offset_s += by_s

    def restart(self, at_s: float) -> None:
        """Count from zero from a time of the simulation (s) on."""
        self._zero_at_s = at_s
        self._offset_s = 0.0
