from pathlib import Path

from brdfpipe import store
from brdfpipe.exchange.reading import read


def main(input, output, params):
    """The BSDF of a file of another program or instrument."""
    raw = Path(input["raw"])
    store.save_dataset(
        read(raw, **params["spec"]),
        output["imported"],
        stage="imported",
        material=params["material"],
        inputs={"raw": raw},
        parameters=params["spec"],
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
