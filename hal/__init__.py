"""The hardware abstraction layer: wires and metal, and nothing of assembly."""
