"""Temperatures of the two members of the spigot, and what heats them."""
