"""Data checks: whether positions, ranges and truth of a recording agree in units, axes and clocks."""
