"""Simulators: servers that speak a device's protocol, with the device's fake behind them."""
