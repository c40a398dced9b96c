"""Emulated rig: serial devices on pseudo-terminals with the faults of real ones, and the optics from lamp to sensor."""
