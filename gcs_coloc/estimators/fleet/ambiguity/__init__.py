"""Reflection ambiguity: the side of its peers that a denied vehicle is on, where ranges fit both."""
