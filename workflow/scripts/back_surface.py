from pathlib import Path

from brdfpipe import store
from brdfpipe.errors import naming_key
from brdfpipe.surfaces.reading import ingest


def main(input, output, params):
    """The measured relief of the back of a clear body: read, checked and levelled like the front."""
    raw = Path(input["raw"])
    with naming_key("slab.back", "surface"):
        surface = ingest(raw, params["spec"])
    store.save_dataset(
        surface,
        output["surface"],
        stage="back_surface",
        material=params["material"],
        inputs={"raw": raw},
        parameters=params["spec"],
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
