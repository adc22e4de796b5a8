"""Fixed stations: ranging devices whose position is known and which have no receiver that could fail."""
