from pathlib import Path

from brdfpipe import store
from brdfpipe.surfaces.reading import ingest
from brdfpipe.surfaces.texture_parameters import with_parameters


def main(input, output, params):
    """A measured surface: read, checked and levelled, with its texture parameters."""
    inputs = {name: Path(path) for name, path in input.items()}
    surface = with_parameters(ingest(inputs["raw"], params["spec"], inputs.get("picture")))
    store.save_dataset(
        surface,
        output["surface"],
        stage="surface",
        material=params["material"],
        inputs=inputs,
        parameters=params["spec"],
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
