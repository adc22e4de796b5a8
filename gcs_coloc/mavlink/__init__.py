"""Bytes to messages and back, sans-IO: framing, codec, our dialect, sequence numbers."""
