"""Trips raced with motion commands, and dead processes at random moments: nothing moves again unasked."""
