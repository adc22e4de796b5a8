"""Who is sent a position, by which method, and whether the autopilot uses it."""
