from pathlib import Path

from brdfpipe import store
from brdfpipe.surfaces.reading import ingest


def main(input, output, params):
    """A measured relief: read, checked and levelled."""
    raw = Path(input["raw"])
    surface = ingest(raw, params["spec"])
    store.save_dataset(
        surface,
        output["surface"],
        stage="surface",
        material=params["material"],
        inputs={"raw": raw},
        parameters=params["spec"],
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
