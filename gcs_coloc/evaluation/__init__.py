"""Data sets, data checks and scoring; no IO but reading tables."""
