"""Backends that speak the devices' own protocols."""
