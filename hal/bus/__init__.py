"""Wires: each file is the only importer of one library and owns connect, poll and recover of its bus."""
