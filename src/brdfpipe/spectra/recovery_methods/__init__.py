"""Methods that recover a reflectance spectrum from a colour, one a module."""
