"""Backends for real devices: the Protocols of hal.interfaces over the buses."""
