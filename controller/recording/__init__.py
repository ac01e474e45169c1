"""Missions as MCAP files: written by ``recorder.py``, read back by ``reader.py``."""
