"""Integrity: tests reported positions and ranges against each other, and excludes faulty vehicles."""
