from pathlib import Path

from brdfpipe import store
from brdfpipe.optics.index import refractive_index


def main(input, output, params):
    """Refractive index: a number, a named plastic or a table."""
    spec, raw = params["spec"], {name: Path(path) for name, path in input.items()}
    index = refractive_index(spec["index"], raw.get("raw"), uncertainty=spec.get("index_uncertainty"))
    store.save_dataset(index, output["index"], stage="index", material=params["material"], inputs=raw, parameters=spec)


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
