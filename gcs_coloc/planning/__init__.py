"""Planning: where along their planned ways vehicles would be located if their GPS failed, and what limits it."""
