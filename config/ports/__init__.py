"""Bundled port descriptions, one YAML file each; read by controller/port_files.py."""
