"""Reflection ambiguity and unresolved outliers: where several positions fit the ranges of a denied vehicle."""
