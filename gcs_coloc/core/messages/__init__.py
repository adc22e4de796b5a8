"""The messages that enter and leave the core, all frozen, each with its time."""
