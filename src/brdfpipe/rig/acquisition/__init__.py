"""Taking frames with a camera rig: its devices, the examination of each, and the scan."""
