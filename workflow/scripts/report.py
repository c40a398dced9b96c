from itertools import chain
from pathlib import Path

from brdfpipe import store
from brdfpipe.report.catalogue import summarise
from brdfpipe.report.material.page import material_page


def main(input, output, params):
    """The page of a material and its row of the catalogue."""
    paths = {stage: path for stage, path in input.items() if isinstance(path, str)}
    paths |= {Path(path).stem: path for path in chain(*(found for found in input.values() if isinstance(found, list)))}
    datasets = {stage: store.open_dataset(path) for stage, path in paths.items()}
    description = params["spec"]["description"]
    store.write_text(output["page"], material_page(datasets, description=description))
    store.save_dataset(
        summarise(datasets, description=description),
        output["summary"],
        stage="report",
        material=params["material"],
        inputs=datasets,
        parameters=params["spec"],
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import by_hand

    by_hand(main)
