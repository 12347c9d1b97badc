"""The cell controller: assembly, and nothing of wires."""
