"""What others may know of a running daemon: its status, figures for Prometheus, health."""
