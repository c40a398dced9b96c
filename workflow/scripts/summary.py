from pathlib import Path

from brdfpipe import store
from brdfpipe.report.catalogue.rows import summarise


def main(input, output, params):
    """The row of a material in the catalogue."""
    datasets = {}
    for stage, files in input.items():
        paths = {stage: files} if isinstance(files, str) else {Path(path).stem: path for path in files}
        datasets |= {name: store.open_dataset(path) for name, path in paths.items()}
    spec = params["spec"]
    store.save_dataset(
        summarise(datasets, description=spec["description"]),
        output["summary"],
        stage="summary",
        material=params["material"],
        inputs=datasets,
        parameters=spec,
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
