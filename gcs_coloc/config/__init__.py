"""File, environment and flags to frozen settings."""
