"""From the frames of a rig to a primary BSDF: the relative light of each cell, then its scale from the calibration."""
