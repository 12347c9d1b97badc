"""The phases of an assembly, each a plain coroutine that gets what it needs and returns a frozen result."""
