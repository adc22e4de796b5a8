"""Benchmarks: speed as ratios to references measured in the same run. `make bench`."""

from gcs_coloc.runtime.process import one_thread

# As the service does it, and before any section imports numpy.
one_thread()
