from pathlib import Path

from brdfpipe import store
from brdfpipe.errors import naming_key
from brdfpipe.surfaces.reading import ingest


def main(input, output, params):
    """The measured relief of the body below a coat: read, checked and levelled like that of the coat."""
    raw = Path(input["raw"])
    with naming_key("coat.base.surface", "surface"):
        surface = ingest(raw, params["spec"])
    store.save_dataset(
        surface,
        output["surface"],
        stage="base_surface",
        material=params["material"],
        inputs={"raw": raw},
        parameters=params["spec"],
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
