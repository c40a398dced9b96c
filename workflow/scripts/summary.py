from brdfpipe import store
from brdfpipe.report import reading
from brdfpipe.report.catalogue.rows import summarise


def main(input, output, params):
    """The row of a material in the catalogue."""
    spec = params["spec"]
    with reading.opened(dict(input.items()), evaluated=("bsdf",)) as datasets:
        store.save_dataset(
            summarise(datasets, **spec),
            output["summary"],
            stage="summary",
            material=params["material"],
            inputs=datasets,
            parameters=spec,
        )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
