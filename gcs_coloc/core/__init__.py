"""The sans-IO core: everything it knows arrives as a message with its time in it, everything it wants is returned."""
