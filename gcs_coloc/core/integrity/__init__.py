"""Reported positions and the ranges between them, each tested against the other, and who is no longer believed."""
