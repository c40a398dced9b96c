"""``python -m brdfpipe`` is ``brdfpipe``."""

from brdfpipe.cli.main import main

main()
