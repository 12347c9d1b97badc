"""Bolted joints and the guns that turn their nuts: torque, preload, traces."""
