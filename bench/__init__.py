"""Benchmarks: speed as ratios to references measured in the same run. `make bench`."""

from gcs_coloc.runtime.process import collect_seldom, one_thread

# As the program does it, and before any section imports numpy.
one_thread()
collect_seldom()
