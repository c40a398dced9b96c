from pathlib import Path

from brdfpipe import store
from brdfpipe.flakes.reading import ingest


def main(input, output, params):
    """Colours or reflectance factors at several geometries."""
    inputs = {name: Path(path) for name, path in input.items()}
    store.save_dataset(
        ingest(params["spec"], inputs.get("raw")),
        output["multiangle"],
        stage="multiangle",
        material=params["material"],
        inputs=inputs,
        parameters=params["spec"],
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
