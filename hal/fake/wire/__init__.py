"""Device simulators: the plant behind the real protocols."""
