"""The doctor: listens to a fleet, asks it a few questions, and says in words what would stop co-localisation, and the remedy."""
