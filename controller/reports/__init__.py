"""Recordings and located scans as self-contained HTML pages."""
