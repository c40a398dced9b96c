from pathlib import Path

from brdfpipe import store
from brdfpipe.spectra.ingestion import ingest


def main(input, output, params):
    """Total reflectance spectrum: measured, or recovered from a colour."""
    inputs = {name: Path(path) for name, path in input.items() if name != "index"}
    if "index" in input:
        inputs["index"] = store.open_dataset(input["index"], "index")
    search = Path(output["spectrum"]).with_name("spectrum.search.json")
    files = {"path": inputs.get("raw"), "excluded": inputs.get("excluded")}
    spectrum = ingest(params["spec"], index=inputs.get("index"), checkpoint=search, **files)
    store.save_dataset(
        spectrum,
        output["spectrum"],
        stage="spectrum",
        material=params["material"],
        inputs=inputs,
        parameters=params["spec"],
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
