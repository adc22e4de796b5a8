"""The aid of a vehicle without GPS: who gets it and when, which way it goes, what is said, and what became of it."""
