"""The camera rig: its devices, the scan, an emulator, and the way from frames to a BSDF."""
