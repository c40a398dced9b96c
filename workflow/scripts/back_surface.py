from pathlib import Path

from brdfpipe import store
from brdfpipe.errors import InputError
from brdfpipe.surfaces.reading import ingest


def main(input, output, params):
    """The measured relief of the back of a clear body: read, checked and levelled like the front."""
    raw = Path(input["raw"])
    try:
        surface = ingest(raw, params["spec"])
    except InputError as refusal:  # the reader names keys of `surface`
        key = refusal.key and refusal.key.replace("surface", "slab.back", 1)
        raise InputError(**(vars(refusal) | {"key": key})) from None
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
