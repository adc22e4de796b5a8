"""The answers of MAV_RESULT that a COMMAND_ACK of the fakes carries."""

ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED, FAILED = 0, 1, 2, 3, 4
