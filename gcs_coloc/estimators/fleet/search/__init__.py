"""The search of a vehicle whose position is not known well enough to linearise its ranges."""
