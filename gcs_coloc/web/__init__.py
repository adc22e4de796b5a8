"""The operator's live page: a small server inside the service.

It is bound to loopback unless configured otherwise.
"""
