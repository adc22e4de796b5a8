"""Whether the parts of a recording agree with each other: units, axes and clocks that are not what they are called. Sans-IO."""
