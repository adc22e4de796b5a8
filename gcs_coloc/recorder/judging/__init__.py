"""Judging: recordings replayed with the present code, and what changed since a baseline."""
