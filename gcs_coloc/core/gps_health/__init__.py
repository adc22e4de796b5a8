"""The GPS health of each vehicle: a state machine fed with evidence."""
