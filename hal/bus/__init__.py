"""What carries a protocol: one owner of each connection, which connects, polls and recovers."""
