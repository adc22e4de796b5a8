"""Observers of the engine: they look on and cannot hold it up."""
