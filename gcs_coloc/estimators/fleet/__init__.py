"""The fleet filter: all vehicles in one state, every range between any two of them, in the order of measuring."""
