"""Files that cannot or must not be measured, and such that must be, made at random from a seed."""
