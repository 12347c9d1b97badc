"""The camera's picture: exact surfaces, lines of sight, instrument errors."""
