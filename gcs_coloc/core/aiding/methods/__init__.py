"""The aiding methods: one module each, and one line in `registry`."""
