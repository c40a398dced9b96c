from .stage import run_as_script as run_as_script
