"""Every error that gcs-coloc raises on purpose: one root, one subclass per cause.

A message of these errors is written for the person at the keyboard: it names the input and the remedy.
"""


class GcsColocError(Exception):
    """Root of all deliberate errors. The command line prints its text as one line."""


class UsageError(GcsColocError):
    """A command line that makes no sense (unknown flag, malformed address)."""


class ConfigError(UsageError):
    """A configuration file that is missing, malformed, or holds an unknown key or impossible value."""


class LinkError(GcsColocError):
    """A link that cannot be opened: port in use, no such serial device, host not found."""


class WebError(GcsColocError):
    """The web page's address is in use or cannot be listened on."""


class EstimatorError(UsageError):
    """An estimator that does not exist, cannot be loaded, or was given settings that it does not have."""


class DataError(GcsColocError):
    """A recording or data set that cannot be read; the text names file, line and column."""


class TaskError(GcsColocError):
    """Tasks that could not be done on several processes: these die."""


class ClusterError(TaskError):
    """A Dask cluster that is not installed, not reachable, without workers, or runs another program."""


class RecordError(GcsColocError):
    """The directory for recordings cannot be written to."""
