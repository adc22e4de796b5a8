"""The composition root: the process, one fleet's path, a replay's."""
