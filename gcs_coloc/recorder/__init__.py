"""Recording flights, and reading, replaying, exporting and reporting them."""
