from pathlib import Path

from brdfpipe import store
from brdfpipe.report.material.page import material_page


def main(input, output, params):
    """The page of a material."""
    datasets = {}
    for stage, files in input.items():
        paths = {stage: files} if isinstance(files, str) else {Path(path).stem: path for path in files}
        datasets |= {name: store.open_dataset(path) for name, path in paths.items()}
    spec = params["spec"]
    page = material_page(datasets, description=spec["description"], exports=spec["exports"])
    store.write_text(output["page"], page)


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
