"""Predictions of plans against drawn flights of the same plans through the fleet filter."""
