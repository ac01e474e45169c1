"""The service: one process that keeps the links and serves one job after the other over a UNIX socket."""
