"""The devices of a rig: monochromator, filter wheel and camera."""
