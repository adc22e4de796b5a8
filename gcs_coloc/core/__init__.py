"""The sans-IO core: messages come in, outputs go out; it has no IO and no clock of its own.

Everything that it knows arrives as a message with its time in it. Everything that it wants is returned.
"""
