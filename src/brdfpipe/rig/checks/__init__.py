"""Checks of frames, one by one in the order they were taken: during a scan, and again when a run is reduced."""
