"""The operator's live page: one small server inside the service, bound to loopback unless configured otherwise."""
