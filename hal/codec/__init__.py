"""Bytes on a wire to frozen messages and back: pure, shared by backends and simulators."""
