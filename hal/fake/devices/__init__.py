"""Fake devices on the plant, with the limits and errors of the real ones."""
