"""Missions back to back on mocks, with random faults: what leaks, and what ends in a way that nothing explains."""
