"""One file per representation of a BSDF; :mod:`brdfpipe.bsdf.registry` lists them."""
