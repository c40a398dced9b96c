"""Acquisition: devices of a camera rig, their examination by the doctor, and the scan."""
