"""Planning: where vehicles would be located along their planned ways if their GPS failed.

It also states what limits the fix there.
"""
