"""Being here puts the repository on the path, so that tests can import `tests.recordings`."""
