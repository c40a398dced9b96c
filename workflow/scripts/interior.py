from pathlib import Path

from brdfpipe import store
from brdfpipe.errors import naming_key
from brdfpipe.optics import interior


def main(input, output, params):
    """The internal transmittance of a clear body or a coat: a number or a table."""
    spec, raw = params["spec"], {name: Path(path) for name, path in input.items()}
    with naming_key(spec.get("body", "slab"), "slab"):
        passed = interior.ingest(spec, raw.get("raw"))
    store.save_dataset(
        passed,
        output["interior"],
        stage="interior",
        material=params["material"],
        inputs=raw,
        parameters=spec,
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
