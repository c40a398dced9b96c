"""The command line ``brdfpipe``."""
