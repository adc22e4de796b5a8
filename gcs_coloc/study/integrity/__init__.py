"""Integrity trials: random flights by class through the real engine, judged against their truth."""
