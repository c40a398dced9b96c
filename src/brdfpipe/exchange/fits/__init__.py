"""Closed forms that other programs evaluate from a few parameters, fitted to a BSDF."""
