"""BSDFs measured on a camera rig: smoothed at each incidence, completed between and beyond them, and evaluated."""
