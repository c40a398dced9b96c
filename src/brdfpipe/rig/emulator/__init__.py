"""An emulated rig: devices on pseudo-terminals that misbehave as real ones do, and the light that passes them."""
