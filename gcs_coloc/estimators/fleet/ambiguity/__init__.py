"""Which side of its peers a denied vehicle is on: reflections that its ranges cannot tell from its position."""
