"""Studs in holes, spigot and faces: forces over the jack's height."""
