"""The fakes' own deliberate errors. Their text is one line for the person at the keyboard."""


class FakesError(Exception):
    """Root of all deliberate errors of the fakes."""

    exit_code = 1


class ScenarioError(FakesError):
    """A scenario that is missing, malformed, or holds an unknown key or an impossible value."""

    exit_code = 2


class SocketError(FakesError):
    """An address that cannot be used."""
