"""Calibrations as files: what each holds, which are in force, what a site's configuration becomes with them."""
