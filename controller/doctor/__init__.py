"""Checks of the computer and the devices before anything moves; each finding with what to do about it."""
