"""Start one emulated controller: ``python -m mocks.ur --host 127.0.0.2``."""

from __future__ import annotations

from mocks.ur.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
