"""Links: bytes with an address and an arrival time, and which vehicle is reached where.

No message is decoded here.
"""
