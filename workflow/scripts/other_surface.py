from pathlib import Path

from brdfpipe import store
from brdfpipe.errors import naming_key
from brdfpipe.surfaces.reading import ingest

KEYS = {"back_surface": "slab.back", "base_surface": "coat.base.surface"}
"""Stage, which its file is named after, and the block of the description that has the keys of the face."""


def main(input, output, params):
    """The measured relief of a further face of a body: read, checked and levelled like the first."""
    raw = Path(input["raw"])
    stage = Path(output["surface"]).stem
    with naming_key(KEYS[stage], "surface"):
        surface = ingest(raw, params["spec"])
    store.save_dataset(
        surface,
        output["surface"],
        stage=stage,
        material=params["material"],
        inputs={"raw": raw},
        parameters=params["spec"],
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
