"""Formats of spectrum files: one module reads one format and registers it."""
